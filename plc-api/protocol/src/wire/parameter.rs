//! Parameters of routes. The same constant describes a parameter in the documents and reads its value from a
//! request, so that a route reads only documented parameters.

use crate::types::CoordinateSystemNumber;
use crate::types::data::JournalFilter;
use crate::types::planned::PATH_TOLERANCE_MM;
use crate::types::run::RUN_WAIT_MAX_S;

/// Reason why received data are not a valid request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fault {
    /// A level of the path has the wrong form.
    Level(String),
    /// The addressed object does not exist.
    NotFound(String),
    /// The body does not have the form of its route or topic.
    Json(String),
    /// A value is missing or out of its range.
    Invalid(String),
}

/// Values in the query of a request; the route determines which of them are read.
#[derive(Debug, Clone, Default)]
pub struct QueryValues {
    /// Number of the first element to answer or write.
    pub from: Option<u32>,
    /// Number of elements to answer or write.
    pub count: Option<u32>,
    /// Text of `wait`: whether, or how long, the answer waits until the request is done.
    pub wait: Option<String>,
    /// Filter for lines of the journal.
    pub filter: JournalFilter,
    /// NC dialect of the stored text.
    pub dialect: Option<String>,
    /// The coordinate system that runs a program.
    pub cs: Option<CoordinateSystemNumber>,
    /// Required accuracy of a planned path, mm.
    pub tolerance: Option<f64>,
    /// Letters of the requested axes.
    pub axes: Option<String>,
}

/// Allowed values of a parameter, as the documents list them.
#[derive(Debug, Clone, Copy)]
pub enum Values {
    /// A whole number: lower bound and upper bound, inclusive; `None` means no upper bound.
    Integer(u32, Option<u32>),
    /// A number that is not less than this value.
    Number(f64),
    /// A text with this minimum and maximum number of characters.
    Text(usize, usize),
    /// A text of any length that the head of a request can contain.
    AnyText,
    /// One of these words.
    Words(&'static [&'static str]),
    /// A text that matches this regular expression.
    Form(&'static str),
}

/// A parameter in the query of a route.
#[derive(Debug, Clone, Copy)]
pub struct QueryParameter {
    /// Name of the parameter.
    pub name: &'static str,
    /// Allowed values.
    pub values: Values,
    /// True if a request without it is refused.
    pub is_required: bool,
    /// Meaning of the parameter.
    pub description: &'static str,
    /// Reads a value into the query values; returns `None` if the text is not valid.
    read: fn(&str, &mut QueryValues) -> Option<()>,
}

/// The query of a route.
#[derive(Debug, Clone, Copy)]
pub struct Query {
    /// Parameters of the query.
    pub parameters: &'static [QueryParameter],
    /// True if the route ignores parameters that are not listed; otherwise it refuses them.
    ignores_others: bool,
}

const fn from(description: &'static str) -> QueryParameter {
    QueryParameter {
        name: "from",
        values: Values::Integer(0, Some(u32::MAX)),
        is_required: false,
        description,
        read: |text, query| {
            query.from = Some(text.parse().ok()?);
            Some(())
        },
    }
}

const fn count(description: &'static str) -> QueryParameter {
    QueryParameter {
        name: "count",
        values: Values::Integer(1, Some(u32::MAX)),
        is_required: false,
        description,
        read: |text, query| {
            query.count = Some(text.parse().ok()?);
            Some(())
        },
    }
}

const fn wait(values: Values, description: &'static str) -> QueryParameter {
    QueryParameter {
        name: "wait",
        values,
        is_required: false,
        description,
        read: |text, query| {
            query.wait = Some(text.to_owned());
            Some(())
        },
    }
}

const fn cs(description: &'static str) -> QueryParameter {
    QueryParameter {
        name: "cs",
        values: Values::Integer(1, Some(255)),
        is_required: false,
        description,
        read: |text, query| {
            query.cs = Some(text.parse().ok()?);
            Some(())
        },
    }
}

/// Creates a parameter of the journal whose value is a text.
const fn journal_text(
    name: &'static str,
    description: &'static str,
    read: fn(&str, &mut QueryValues) -> Option<()>,
) -> QueryParameter {
    QueryParameter {
        name,
        values: Values::Text(0, JOURNAL_TEXT_MAX),
        is_required: false,
        description,
        read,
    }
}

/// Largest number of characters of a journal parameter. Reason: no valid name or time is longer.
const JOURNAL_TEXT_MAX: usize = 256;

/// Largest number of characters of a dialect's name. Reason: no name is longer.
const DIALECT_NAME_MAX: usize = 32;

const DIALECT: QueryParameter = QueryParameter {
    name: "dialect",
    values: Values::Text(1, DIALECT_NAME_MAX),
    is_required: false,
    description: "Name of the NC dialect of the text, as in the configuration; default: the dialect of the lowest coordinate system.",
    read: |text, query| {
        query.dialect = Some(text.to_owned());
        Some(())
    },
};

const AXES: QueryParameter = QueryParameter {
    name: "axes",
    values: Values::Text(0, 9),
    is_required: false,
    description: "Letters of the axes, such as XZ; default: all axes.",
    read: |text, query| {
        query.axes = Some(text.to_owned());
        Some(())
    },
};

const TOLERANCE: QueryParameter = QueryParameter {
    name: "tolerance",
    values: Values::Number(PATH_TOLERANCE_MM),
    is_required: false,
    description: "Largest distance of a point of the path from the lines, mm: levels of detail that are finer are left out.",
    read: |text, query| {
        query.tolerance = Some(text.parse().ok()?);
        Some(())
    },
};

const RUN_BY: QueryParameter = cs(
    "The coordinate system that runs the program; default: the first one in which it is loaded, otherwise the one whose configuration names it, otherwise the first one.",
);

impl Query {
    /// A query without parameters.
    pub const NOTHING: Self = Self {
        parameters: &[],
        ignores_others: true,
    };

    /// Parameters `from` and `count` of a range of values to read.
    pub const RANGE: Self = Self::from_parameters(&[
        from("Number of the first value; default 0."),
        count("Number of values; default 1."),
    ]);

    /// Parameters of a range of values to write. The number of the first value has no default: a request
    /// without this number would overwrite the first values.
    pub const RANGE_TO_WRITE: Self = Self::from_parameters(&[
        QueryParameter {
            is_required: true,
            ..from("Number of the first value.")
        },
        count("Number of values; must be the number of values in the body."),
    ]);

    /// Parameters that filter lines of the journal.
    pub const JOURNAL: Self = Self::from_parameters(&[
        journal_text(
            "since",
            "Lines from this time on: in UTC, such as 2026-11-25 or 2026-11-25T10:00, or an age, such as 2h or 30m.",
            |text, query| {
                query.filter.since = Some(text.to_owned());
                Some(())
            },
        ),
        journal_text(
            "until",
            "Lines before this time, in the same format.",
            |text, query| {
                query.filter.until = Some(text.to_owned());
                Some(())
            },
        ),
        QueryParameter {
            values: Values::Integer(0, Some(255)),
            read: |text, query| {
                query.filter.cs = Some(text.parse().ok()?);
                Some(())
            },
            ..cs("Lines of this coordinate system; 0 for lines of the machine.")
        },
        QueryParameter {
            name: "m",
            values: Values::Integer(0, Some(65_535)),
            is_required: false,
            description: "Lines about outputs of this M number, and about stops that it caused.",
            read: |text, query| {
                query.filter.m = Some(text.parse().ok()?);
                Some(())
            },
        },
        journal_text("user", "Lines of this user, client or handler.", |text, query| {
            query.filter.user = Some(text.to_owned());
            Some(())
        }),
        journal_text(
            "run",
            "Lines of this run, such as 1-7, or BOOT/1-7 for that start of the runtime.",
            |text, query| {
                query.filter.run = Some(text.to_owned());
                Some(())
            },
        ),
        from("Number of newest lines to skip; default 0."),
        count("Number of lines; default 100."),
    ]);

    /// Parameter that makes the answer to a command wait until the command is done.
    pub const WAIT: Self = Self {
        parameters: &[wait(
            Values::Words(&["0", "1", "false", "true", ""]),
            "1, true or an empty value: the answer follows when the command is done, or with 202 after one minute.",
        )],
        ignores_others: true,
    };

    /// Parameter with the seconds to wait for the end of a run.
    pub const SECONDS: Self = Self::from_parameters(&[wait(
        Values::Integer(0, Some(RUN_WAIT_MAX_S)),
        "Longest wait for the end of the run, s; default: the answer follows at once.",
    )]);

    /// Parameters that select runs.
    pub const RUNS: Self = Self::from_parameters(&[
        cs("Runs of this coordinate system only."),
        from("Number of newest runs to skip; default 0."),
        count("Number of runs; default 100."),
    ]);

    /// Parameter with the NC dialect of a program.
    pub const DIALECT: Self = Self::from_parameters(&[DIALECT]);

    /// Parameters that select samples of the recent motion.
    pub const TRACE: Self = Self::from_parameters(&[
        AXES,
        from("Number of the first sample; default 0."),
        count("Number of samples; default: all."),
    ]);

    /// Parameter with the coordinate system that runs a program.
    pub const RUN_BY: Self = Self::from_parameters(&[RUN_BY]);

    /// Parameters that select a part of a planned path.
    pub const PATH: Self = Self::from_parameters(&[
        RUN_BY,
        TOLERANCE,
        from("Number of the first point; default 0."),
        count("Number of points; default: all."),
    ]);

    const fn from_parameters(parameters: &'static [QueryParameter]) -> Self {
        Self {
            parameters,
            ignores_others: false,
        }
    }

    /// Parses the names and values of a query.
    ///
    /// # Errors
    /// Fails if a parameter is not listed or occurs twice, a value is not valid, or a required parameter is
    /// missing.
    pub fn read<'a>(
        &self,
        pairs: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<QueryValues, Fault> {
        let mut values = QueryValues::default();
        let mut seen = Vec::new();
        for (name, text) in pairs {
            let Some(parameter) = self.parameters.iter().find(|parameter| parameter.name == name) else {
                if self.ignores_others {
                    continue;
                }
                return Err(self.fault(&format!("the query has the unknown parameter {name:.64}")));
            };
            if seen.contains(&parameter.name) {
                return Err(self.fault(&format!("the query has {name} twice")));
            }
            seen.push(parameter.name);
            let is_read =
                parameter.values.admits_length_of(text) && (parameter.read)(text, &mut values).is_some();
            if !is_read {
                let shown = parameter.values.shown();
                return Err(Fault::Invalid(format!("{name}={text:.64}: write {shown}")));
            }
        }
        let mut required = self.parameters.iter().filter(|parameter| parameter.is_required);
        match required.find(|parameter| !seen.contains(&parameter.name)) {
            Some(QueryParameter { name, values, .. }) => Err(Fault::Invalid(format!(
                "the query lacks {name}, the address of the values to write; write ?{name}= and {}",
                values.shown()
            ))),
            None => Ok(values),
        }
    }

    fn fault(&self, text: &str) -> Fault {
        let names: Vec<_> = self.parameters.iter().map(|parameter| parameter.name).collect();
        Fault::Invalid(format!("{text}; write each of {} at most once", names.join(", ")))
    }
}

impl Values {
    /// Returns false for a text with fewer or more characters than the document allows.
    fn admits_length_of(&self, text: &str) -> bool {
        match self {
            Values::Text(min, max) => (*min..=*max).contains(&text.chars().count()),
            _ => true,
        }
    }

    /// Returns the allowed values in words, for an error text.
    fn shown(&self) -> String {
        match self {
            Values::Integer(min, Some(max)) => format!("a whole number, {min} to {max}"),
            Values::Integer(min, None) => format!("a whole number, {min} or more"),
            Values::Number(min) => format!("a number, {min} or more"),
            Values::Text(min, max) => format!("{min} to {max} characters"),
            Values::AnyText => "a text".to_owned(),
            Values::Words(words) => words.join(" or "),
            Values::Form(form) => format!("a text of the form {form}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(query: Query, pairs: &[(&str, &str)]) -> String {
        match query.read(pairs.iter().copied()) {
            Err(Fault::Invalid(text)) => text,
            other => panic!("{pairs:?}: {other:?}"),
        }
    }

    #[test]
    fn a_write_without_the_number_of_the_first_value_is_refused() {
        assert_eq!(
            refusal(Query::RANGE_TO_WRITE, &[("count", "2")]),
            "the query lacks from, the address of the values to write; write ?from= and a whole number, 0 to 4294967295"
        );
        assert_eq!(Query::RANGE_TO_WRITE.read([("from", "0")]).unwrap().from, Some(0));
        assert_eq!(Query::RANGE.read([]).unwrap().from, None);
    }

    #[test]
    fn unknown_doubled_and_malformed_parameters_are_refused_by_name() {
        assert_eq!(
            refusal(Query::RANGE, &[("form", "1")]),
            "the query has the unknown parameter form; write each of from, count at most once"
        );
        assert_eq!(
            refusal(Query::RANGE, &[("from", "1"), ("from", "2")]),
            "the query has from twice; write each of from, count at most once"
        );
        assert_eq!(
            refusal(Query::RUNS, &[("cs", "256")]),
            "cs=256: write a whole number, 1 to 255"
        );
        assert_eq!(
            refusal(Query::PATH, &[("tolerance", "fine")]),
            "tolerance=fine: write a number, 0.01 or more"
        );
    }

    #[test]
    fn a_command_ignores_parameters_that_it_does_not_read() {
        let values = Query::WAIT.read([("time", "12"), ("wait", "1")]).unwrap();
        assert_eq!(values.wait.as_deref(), Some("1"));
        assert!(Query::NOTHING.read([("time", "12")]).is_ok());
    }
}
