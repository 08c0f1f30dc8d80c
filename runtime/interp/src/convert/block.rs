//! One block: what is in force before it, and the blocks of nj that do the same.

use tandem_model::settings::Unit;
use tandem_syntax::{Address, Block, Grammar, NcProgram, Word};

use super::state::{Cycle, POSITIONS, Source, State, Words, shown};

/// M codes that these controls carry out before the motion of their block.
const BEFORE_MOTION: [u32; 6] = [3, 4, 6, 7, 8, 13];

/// G91.1: I, J and K count from the start of an arc, as they do here.
const CENTRES_ARE_DISTANCES: f64 = 91.1;

/// S below it is the number of a speed in dialect dgshape.
const SPEED_MIN: f64 = 100.0;

impl State {
    /// The blocks of nj that do what this one does.
    pub fn block(&mut self, program: &NcProgram, block: &Block) -> Result<Vec<String>, String> {
        let mut words = Words::of(program.words(block));
        let skip = if block.skip_numbers() == 0 { "" } else { "/ " };
        if !skip.is_empty() && (self.cycle.is_some() || words.has(&[Address::G, Address::T])) {
            return Err(
                "a block that may be skipped changes what is in force: write it without the codes".to_owned(),
            );
        }
        let number = words
            .take(Address::N)
            .map(|word| format!("N{} ", word.number().unwrap_or_default()));
        let mut lines = self.lines(&mut words)?;
        if let Some(left) = words.all.iter().flatten().next() {
            return Err(Self::no_equal(left));
        }
        if lines.is_empty() && number.is_some() {
            lines.push(String::new());
        }
        if !skip.is_empty() {
            self.z = None;
        }
        let number = number.unwrap_or_default();
        let begin = |(at, line): (usize, String)| {
            let number = if at == 0 { number.as_str() } else { "" };
            format!("{skip}{number}{line}").trim_end().to_owned()
        };
        Ok(lines.into_iter().enumerate().map(begin).collect())
    }

    /// Why a word cannot be written in nj.
    fn no_equal(word: &Word) -> String {
        let value = word.number().unwrap_or_default();
        let name = match word.address {
            Address::G | Address::M => format!("{}{value}", word.address.text()),
            address => address.text().to_owned(),
        };
        let help = Grammar::nj().foreign(&name, &value.to_string());
        let help = help.unwrap_or_else(|| "Write by hand what it does.".to_owned());
        format!("{}{value} has no equal here. {help}", word.address.text())
    }

    fn lines(&mut self, words: &mut Words<'_>) -> Result<Vec<String>, String> {
        let mut modal = Vec::new();
        let codes = self.codes(words, &mut modal)?;
        let (mut before, mut behind) = (Vec::new(), Vec::new());
        if let Some(speed) = words.take(Address::S) {
            let speed = speed.number().unwrap_or_default();
            if self.from == Source::Dgshape && speed < SPEED_MIN {
                return Err(format!(
                    "S{speed} is the number of a speed. Write the speed in r/min."
                ));
            }
            modal.push(format!("S{speed}"));
        }
        self.m_codes(words, &mut before, &mut behind)?;
        if let Some(feedrate) = words.take(Address::F) {
            modal.push(format!("F{}", shown(self.value(feedrate)?)));
        }
        let action = match codes.action {
            Action::Dwell => vec![self.dwell(words)?],
            Action::Reference => vec![self.reference(words)?],
            Action::Coordinates(code) => vec![self.coordinates(words, code)?],
            Action::Length(on) => self.length(words, on)?,
            Action::Motion if self.cycle.is_some() => self.holes(words, codes.begins_cycle)?,
            Action::Motion => self.motion(words, codes.names_motion)?,
        };
        // what stays in force stands before what moves
        let modal = modal.join(" ");
        let mut lines = Vec::new();
        if !before.is_empty() {
            // the speed is that of the spindle that an M code turns
            lines.push(format!("{modal} {}", before.join(" ")).trim_start().to_owned());
            lines.extend(action);
        } else if let Some((first, rest)) = action.split_first() {
            lines.push(format!("{modal} {first}").trim_start().to_owned());
            lines.extend(rest.iter().cloned());
        } else if !modal.is_empty() {
            lines.push(modal);
        }
        lines.extend(behind);
        Ok(lines)
    }

    /// Takes the G codes: what they set, and what the block does.
    fn codes(&mut self, words: &mut Words<'_>, modal: &mut Vec<String>) -> Result<Codes, String> {
        let mut codes = Codes {
            action: Action::Motion,
            names_motion: false,
            begins_cycle: false,
        };
        while let Some(word) = words.take(Address::G) {
            if self.from == Source::Fanuc && word.number() == Some(CENTRES_ARE_DISTANCES) {
                continue;
            }
            let number = word.whole().ok_or_else(|| Self::no_equal(word))?;
            match number {
                0..=3 => {
                    self.motion = ["G00", "G01", "G02", "G03"][number as usize % 4];
                    self.cycle = None;
                    codes.names_motion = true;
                }
                4 => codes.action = Action::Dwell,
                17..=19 | 40 => modal.push(format!("G{number}")),
                20 | 21 => {
                    self.unit = if number == 20 {
                        Unit::Inch
                    } else {
                        Unit::Millimetre
                    };
                    self.z = None;
                    modal.push(format!("G{number}"));
                }
                28 => codes.action = Action::Reference,
                41 | 42 => {
                    self.own_tool(words.take(Address::D), "D")?;
                    modal.push(format!("G{number}"));
                }
                43 => codes.action = Action::Length(true),
                49 => codes.action = Action::Length(false),
                54..=59 => {
                    self.z = None;
                    modal.push(format!("G{number}"));
                }
                80 => self.cycle = None,
                81 | 82 | 83 | 85 | 86 | 89 => {
                    self.cycle = Some(Cycle::new(number, self.cycle.take(), self.z, self.absolute));
                    codes.begins_cycle = true;
                }
                90 | 91 => {
                    self.absolute = number == 90;
                    modal.push(format!("G{number}"));
                }
                52 if self.from == Source::Fanuc => {
                    self.is_local = true;
                    codes.action = Action::Coordinates("G52");
                }
                53 if self.from == Source::Fanuc => codes.action = Action::Coordinates("G53"),
                61 | 64 | 50 | 69 if self.from == Source::Fanuc => modal.push(format!("G{number}")),
                // feedrates in mm/min, speeds in r/min
                94 | 97 if self.from == Source::Fanuc => {}
                98 | 99 => self.to_initial = number == 98,
                _ => return Err(Self::no_equal(word)),
            }
        }
        Ok(codes)
    }

    /// The offset of a number is that of the tool of this number: nj takes that of the tool in the spindle.
    fn own_tool(&self, offset: Option<&Word>, letter: &str) -> Result<(), String> {
        let number = offset
            .and_then(Word::whole)
            .ok_or_else(|| format!("it has no {letter}"))?;
        if Some(number) == self.tool {
            return Ok(());
        }
        let tool = self
            .tool
            .map_or_else(|| "no tool is known".to_owned(), |tool| format!("it is T{tool}"));
        Err(format!(
            "{letter}{number} is not the offset of the tool in the spindle ({tool}). Write its M06 before it, or give the \
             tool these measures."
        ))
    }

    /// Takes M codes and T: those before the motion, and those behind it.
    fn m_codes(
        &mut self,
        words: &mut Words<'_>,
        before: &mut Vec<String>,
        behind: &mut Vec<String>,
    ) -> Result<(), String> {
        if let Some(tool) = words.take(Address::T) {
            let tool = tool.whole().ok_or("T is no whole number")?;
            self.next_tool = Some(tool);
            let changes = |word: &&Word| word.address == Address::M && word.whole() == Some(6);
            if !words.all.iter().flatten().any(changes) {
                if self.from == Source::Dgshape {
                    return Err("T alone changes no tool. Write M06 VA_ at the change.".to_owned());
                }
                // the magazine turns meanwhile, and nothing moves
                self.note = Some(format!("T{tool} is called"));
            }
        }
        while let Some(word) = words.take(Address::M) {
            let number = word.whole().ok_or_else(|| Self::no_equal(word))?;
            let text = match number {
                6 => {
                    let tool = self.next_tool.take().ok_or("M06 has no T. Write M06 VA_.")?;
                    self.tool = Some(tool);
                    format!("M06 VA{tool}")
                }
                98 if self.from == Source::Fanuc => {
                    self.z = None;
                    let program = words.take(Address::P).and_then(Word::whole);
                    let program = program.filter(|number| (1000..=9999).contains(number));
                    let program = program.ok_or("the number of a subprogram is 1000 to 9999. Rename it.")?;
                    let times = words.take(Address::L).and_then(Word::whole);
                    format!(
                        "M98 P{program}{}",
                        times.map_or_else(String::new, |times| format!(" L{times}"))
                    )
                }
                _ => format!("M{number:02}"),
            };
            let is_before = self.from == Source::Dgshape || BEFORE_MOTION.contains(&number);
            if is_before { &mut *before } else { &mut *behind }.push(text);
        }
        Ok(())
    }

    fn dwell(&self, words: &mut Words<'_>) -> Result<String, String> {
        let seconds = match (words.take(Address::X), words.take(Address::P)) {
            (Some(seconds), None) if self.from == Source::Dgshape && seconds.is_whole() => {
                seconds.number().unwrap_or_default() / 1000.0
            }
            (Some(seconds), None) => seconds.number().unwrap_or_default(),
            (None, Some(milliseconds)) => milliseconds.number().unwrap_or_default() / 1000.0,
            _ => return Err("it has no time".to_owned()),
        };
        Ok(format!("G04 X{}", shown(seconds)))
    }

    /// A return to the reference point, of the axes that it names.
    fn reference(&mut self, words: &mut Words<'_>) -> Result<String, String> {
        let named: Vec<Address> = POSITIONS.into_iter().filter(|axis| words.has(&[*axis])).collect();
        let remembers = self.from == Source::Dgshape;
        if remembers && self.returned.iter().any(|axis| !named.contains(axis)) {
            return Err("axes that an earlier G28 has named return, too. Name them in this one.".to_owned());
        }
        if named.is_empty() {
            return Err("it names no axis. Name those that return.".to_owned());
        }
        self.returned.clone_from(&named);
        self.z = None;
        Ok(format!("G28 {}", self.positions(words)?.join(" ")))
    }

    /// G52 and G53.
    fn coordinates(&mut self, words: &mut Words<'_>, code: &str) -> Result<String, String> {
        if code == "G53" && (self.is_local || !self.absolute || self.motion != "G00") {
            let why = "G53 moves at rapid speed to absolute positions here, and ends G52. Write G90, G00 and G52 with it.";
            return Err(why.to_owned());
        }
        let positions = self.positions(words)?.join(" ");
        self.z = None;
        Ok(format!("{code} {positions}").trim_end().to_owned())
    }

    /// G43 and G49: without axis words they move Z by the change of the offset.
    fn length(&mut self, words: &mut Words<'_>, on: bool) -> Result<Vec<String>, String> {
        let code = if on { "G43" } else { "G49" };
        if on {
            self.own_tool(words.take(Address::H), "H")?;
        }
        let offset = self.tool.filter(|_| on);
        let changes = std::mem::replace(&mut self.offset, offset) != offset;
        if words.has(&POSITIONS) {
            let mut lines = self.motion(words, false)?;
            if let Some(first) = lines.first_mut() {
                *first = format!("{code} {first}");
            }
            return Ok(lines);
        }
        if self.from == Source::Fanuc || !changes {
            return Ok(vec![code.to_owned()]);
        }
        let motion = if self.motion == "G00" { "G00" } else { "G01" };
        let back = self.absolute.then(|| "G90".to_owned());
        let moves = [code.to_owned(), format!("G91 {motion} Z0")];
        Ok(moves.into_iter().chain(back).collect())
    }

    fn motion(&mut self, words: &mut Words<'_>, named: bool) -> Result<Vec<String>, String> {
        let is_arc = matches!(self.motion, "G02" | "G03");
        let centre = [Address::I, Address::J, Address::K, Address::R];
        let moves = words.has(&POSITIONS) || (is_arc && words.has(&centre));
        if !moves {
            return Ok(if named {
                vec![self.motion.to_owned()]
            } else {
                Vec::new()
            });
        }
        if words.has(&[Address::A]) && self.motion != "G00" {
            return Err(
                "the feedrate of A is that of the surface there. Write the motion with the F that it needs."
                    .to_owned(),
            );
        }
        let mut parts = vec![self.motion.to_owned()];
        parts.extend(self.positions(words)?);
        if is_arc {
            for address in centre {
                if let Some(word) = words.take(address) {
                    parts.push(format!("{}{}", address.text(), shown(self.value(word)?)));
                }
            }
        }
        Ok(vec![parts.join(" ")])
    }
}

/// What the G codes of a block say.
struct Codes {
    action: Action,
    names_motion: bool,
    begins_cycle: bool,
}

/// What a block does.
enum Action {
    Motion,
    Dwell,
    Reference,
    /// Local coordinates, or a move to a position of the machine: G52, G53.
    Coordinates(&'static str),
    /// The tool length offset begins or ends.
    Length(bool),
}
