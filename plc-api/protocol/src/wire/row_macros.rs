//! Macros that define the rows of requests.

/// Defines the function `write` of a row: it splits a request of this row, and returns any other request
/// unchanged.
macro_rules! written {
    ($request:pat => $parts:expr) => {
        |request| match request {
            $request => Ok($parts),
            other => Err(other),
        }
    };
}

/// Defines the row of a request whose values are numbers or names in the path, or the JSON body.
macro_rules! carried {
    ($right:ident, $request:ident) => {
        Row::new(
            $right,
            |_| Ok(Request::$request),
            written!(Request::$request => RequestParts::default()),
        )
    };
    ($right:ident, $request:ident($($value:ident: $kind:ident),*)) => {
        Row::new(
            $right,
            |incoming| Ok(Request::$request($(carried!(@read incoming, $value, $kind)),*)),
            written!(Request::$request($($value),*) => {
                let parts = RequestParts::default();
                $(let parts = carried!(@write parts, $value, $kind);)*
                parts
            }),
        )
    };
    (@read $incoming:ident, $value:ident, number) => { $incoming.number(stringify!($value))? };
    (@read $incoming:ident, $value:ident, name) => { $incoming.text(stringify!($value)).to_owned() };
    (@read $incoming:ident, $value:ident, json) => { $incoming.json()? };
    (@write $parts:ident, $value:ident, json) => { $parts.json(&$value) };
    (@write $parts:ident, $value:ident, $level:ident) => { $parts.with(stringify!($value), $value) };
}

/// Defines the row of a message about an output: the route contains the sequence number of the output, the
/// topic its M number.
macro_rules! about_an_output {
    ($request:ident($type:ty) $level:literal $right:ident $(-> $answer:ty)? $(, on $result:literal)? => $summary:literal) => {
        Row {
            routes: &[Route::post::<$type>(
                super::subject::Subject::MCodes,
                concat!("/cs/{cs}/m_codes/{seq}/", $level),
                &[super::path_parameter::CS, super::path_parameter::SEQ],
                $summary,
            )$(.gives::<$answer>())?],
            topic: Some(
                InboundTopic::new::<$type>(concat!("cs/{cs}/m_code/{m}/", $level), $summary)
                    $(.answered_on($result))?,
            ),
            answer: handshake,
            ..Row::new(
                $right,
                |incoming| Ok(Request::$request(incoming.cs()?, incoming.optional_number("m")?, incoming.json()?)),
                written!(Request::$request(cs, m, said) => RequestParts::for_output(cs, m, said.seq, &said)),
            )
        }
    };
}

pub(super) use {about_an_output, carried, written};
