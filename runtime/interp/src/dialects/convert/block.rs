//! Converts one block to equivalent blocks of nj, depending on the modal state before the block.

use tandem_model::settings::CompensationStart;
use tandem_syntax::{Address, Block, Grammar, NcProgram, Word};

use super::state::{ConversionState, CycleState, POSITIONS, Source, Words, shown};

/// M codes that the controls of the source execute before the motion of the block.
pub(super) const BEFORE_MOTION: [u32; 6] = [3, 4, 6, 7, 8, 13];

/// M29: the spindle turns in step with Z in a tapping cycle.
const RIGID_TAPPING: u32 = 29;

/// G91.1: I, J and K are distances from the start of an arc, as always in nj.
const CENTRES_ARE_DISTANCES: f64 = 91.1;

/// G51.1 switches mirroring on, G50.1 off.
const MIRRORING: [(f64, bool); 2] = [(51.1, true), (50.1, false)];

/// From this value of P on, the digits of P before the last four are the number of calls by M98.
const CALLS_FROM: u32 = 10_000;

/// G codes that are allowed in a block that may be skipped: if they are already active, they change nothing.
const SKIPPABLE: [u32; 7] = [0, 1, 2, 3, 4, 90, 91];

/// Value below which S is the number of a speed in dialect dgshape.
const SPEED_MIN: f64 = 100.0;

/// Returns the block skip numbers of a block in the notation of nj.
fn skips(numbers: u32) -> String {
    let all = (1..=u32::BITS).filter(|number| numbers >> (number - 1) & 1 == 1);
    let all: Vec<String> = all
        .map(|number| {
            if number == 1 {
                "/".to_owned()
            } else {
                format!("/{number}")
            }
        })
        .collect();
    let gap = if all.is_empty() { "" } else { " " };
    all.join(" ") + gap
}

impl ConversionState {
    /// Returns the blocks of nj that are equivalent to a block of the source.
    pub fn block(&mut self, program: &NcProgram, block: &Block) -> Result<Vec<String>, String> {
        let mut words = Words::new(program.words(block));
        let skip = skips(block.skip_numbers());
        let changes = || {
            Err(
                "a block with block skip changes modal codes. Write them in a block that is not skipped"
                    .to_owned(),
            )
        };
        let holds = |word: &&Word| {
            word.address != Address::G || word.whole().is_some_and(|code| SKIPPABLE.contains(&code))
        };
        if !skip.is_empty()
            && (self.cycle.is_some() || words.has(&[Address::T]) || !words.all.iter().flatten().all(holds))
        {
            return changes();
        }
        let before = (self.motion, self.absolute);
        let number = words
            .take_word(Address::N)
            .map(|word| format!("N{} ", word.number().unwrap_or_default()));
        let mut lines = self.lines(&mut words)?;
        if let Some(left) = words.all.iter().flatten().next() {
            return Err(Self::no_equal(left));
        }
        if lines.is_empty() && number.is_some() {
            lines.push(String::new());
        }
        if !skip.is_empty() {
            if before != (self.motion, self.absolute) {
                return changes();
            }
            self.lose_position();
        }
        let number = number.unwrap_or_default();
        let begin = |(at, line): (usize, String)| {
            let number = if at == 0 { number.as_str() } else { "" };
            format!("{skip}{number}{line}").trim_end().to_owned()
        };
        Ok(lines.into_iter().enumerate().map(begin).collect())
    }

    /// Returns the reason why a word has no equivalent in nj.
    fn no_equal(word: &Word) -> String {
        let value = word.number().unwrap_or_default();
        let name = match word.address {
            Address::G | Address::M => format!("{}{value}", word.address.text()),
            address => address.text().to_owned(),
        };
        let help = Grammar::nj().foreign(&name, &value.to_string());
        let help = help.unwrap_or_else(|| "Write its effect by hand.".to_owned());
        format!("{}{value} has no equivalent in nj. {help}", word.address.text())
    }

    fn lines(&mut self, words: &mut Words<'_>) -> Result<Vec<String>, String> {
        let mut modal = Vec::new();
        let codes = self.codes(words, &mut modal)?;
        let (mut before, mut behind) = (Vec::new(), Vec::new());
        if let Some(speed) = words.take_word(Address::S) {
            let speed = speed.number().unwrap_or_default();
            if self.from == Source::Dgshape && speed < SPEED_MIN {
                return Err(format!(
                    "S{speed} is the number of a speed. Write the speed in r/min."
                ));
            }
            let speed = match self.from {
                Source::Dgshape => self.options.spindle_speed_within(speed),
                Source::Fanuc => speed,
            };
            modal.push(format!("S{speed}"));
        }
        self.m_codes(words, &mut before, &mut behind)?;
        if let Some(feedrate) = words.take_word(Address::F) {
            let feedrate = self.value(feedrate)?;
            modal.push(format!("F{}", shown(self.feedrate_within(feedrate))));
        }
        let action = match codes.action {
            Action::Dwell => vec![self.dwell(words)?],
            Action::Reference(code) => vec![self.reference(words, code)?],
            Action::Local => vec![self.local_coordinates(words)?],
            Action::Shift => vec![self.shifted_coordinates(words)?],
            Action::Machine => vec![self.machine_position(words)?],
            Action::Rotation => vec![self.rotation(words)?],
            Action::Scaling => vec![self.scaling(words)?],
            Action::Mirroring(on) => vec![self.mirroring(words, on)?],
            Action::Length(on) => self.length(words, on)?,
            Action::Motion if self.cycle.is_some() => self.holes(words, codes.begins_cycle)?,
            Action::Motion => self.motion(words, &codes)?,
        };
        if behind.iter().any(|line| line.starts_with("M98")) {
            self.lose_modal_state();
        }
        if let Some(number) = codes.ends_tapping {
            // the cycle of nj has stopped the spindle: this M code starts it again
            before.insert(0, format!("M{number:02}"));
        }
        // modal words come first: before the motion, and S before the M code that turns the spindle
        let modal = modal.join(" ");
        let mut lines: Vec<String> = before.into_iter().chain(action).collect();
        if let Some(first) = lines.first_mut() {
            first.insert_str(0, if modal.is_empty() { "" } else { " " });
            first.insert_str(0, &modal);
        } else if !modal.is_empty() {
            lines.push(modal);
        }
        lines.extend(behind);
        Ok(lines)
    }

    /// Takes the G codes of the block: adds their modal values to `modal`, and returns their action.
    fn codes(&mut self, words: &mut Words<'_>, modal: &mut Vec<String>) -> Result<Codes, String> {
        let mut codes = Codes::default();
        let taps = self.cycle.as_ref().is_some_and(CycleState::taps);
        while let Some(word) = words.take_word(Address::G) {
            if self.from == Source::Fanuc && word.number() == Some(CENTRES_ARE_DISTANCES) {
                continue;
            }
            let mirrors = MIRRORING.iter().find(|(code, _)| word.number() == Some(*code));
            if let Some((_, on)) = mirrors.filter(|_| self.from == Source::Fanuc) {
                codes.action = Action::Mirroring(*on);
                continue;
            }
            let number = word.whole().ok_or_else(|| Self::no_equal(word))?;
            self.activate_code(number);
            match number {
                0..=3 => codes.names_motion = true,
                4 => codes.action = Action::Dwell,
                17..=19 | 40 | 90 | 91 => modal.push(format!("G{number}")),
                20 | 21 => {
                    self.lose_position();
                    modal.push(format!("G{number}"));
                }
                28 => codes.action = Action::Reference("G28"),
                41 | 42 if self.options.compensation_start == CompensationStart::B => {
                    return Err("the configuration selects type B for the start of cutter compensation, and nj uses type A. Write the lead-in and the lead-out by hand.".to_owned());
                }
                41 | 42 => {
                    self.own_tool(words.take_word(Address::D), "D")?;
                    modal.push(format!("G{number}"));
                }
                43 => codes.action = Action::Length(true),
                50 => {
                    self.is_scaled = false;
                    self.lose_position();
                    modal.push("G50".to_owned());
                }
                51 => codes.action = Action::Scaling,
                49 => codes.action = Action::Length(false),
                54..=59 => {
                    self.in_plain_shape(&format!("G{number}"))?;
                    self.lose_position();
                    modal.push(format!("G{number}"));
                }
                80 | 98 | 99 => {}
                81 | 82 | 83 | 85 | 86 | 89 => {
                    self.begin_cycle(number)?;
                    codes.begins_cycle = true;
                }
                92 => codes.action = Action::Shift,
                _ if self.from == Source::Fanuc => self.fanuc_code(word, number, &mut codes, modal)?,
                _ => return Err(Self::no_equal(word)),
            }
        }
        if taps && !self.cycle.as_ref().is_some_and(CycleState::taps) {
            modal.insert(0, "G80".to_owned());
            if std::mem::take(&mut self.is_rigid) {
                self.spindle = None;
            }
            codes.ends_tapping = self.spindle;
        }
        Ok(codes)
    }

    /// Converts a G code that dialect dgshape does not have, or has with another meaning.
    fn fanuc_code(
        &mut self,
        word: &Word,
        number: u32,
        codes: &mut Codes,
        modal: &mut Vec<String>,
    ) -> Result<(), String> {
        match number {
            9 => codes.stops_exactly = true,
            30 => codes.action = Action::Reference("G30"),
            52 => codes.action = Action::Local,
            53 => codes.action = Action::Machine,
            68 => codes.action = Action::Rotation,
            69 => {
                self.is_rotated = false;
                self.lose_position();
                modal.push("G69".to_owned());
            }
            61 | 64 => modal.push(format!("G{number}")),
            73 | 74 | 84 => {
                self.begin_cycle(number)?;
                codes.begins_cycle = true;
            }
            // G94 and G97: feedrates in mm/min and speeds in r/min, as always in nj
            94 | 97 => {}
            _ => return Err(Self::no_equal(word)),
        }
        Ok(())
    }

    /// Checks that an offset number is the number of the tool in the spindle: nj always uses the offset of
    /// that tool.
    fn own_tool(&self, offset: Option<&Word>, letter: &str) -> Result<(), String> {
        let number = offset
            .and_then(Word::whole)
            .ok_or_else(|| format!("the block has no {letter}"))?;
        if Some(number) == self.tool {
            return Ok(());
        }
        let tool = self
            .tool
            .map_or_else(|| "unknown".to_owned(), |tool| format!("T{tool}"));
        Err(format!(
            "{letter}{number} is not the offset of the tool in the spindle ({tool}). Write an M06 with its \
             tool before it, or give the tool in the spindle this offset."
        ))
    }

    /// Converts M codes and T. M codes that act before the motion are added to `before`, other M codes to
    /// `behind`.
    fn m_codes(
        &mut self,
        words: &mut Words<'_>,
        before: &mut Vec<String>,
        behind: &mut Vec<String>,
    ) -> Result<(), String> {
        if let Some(tool) = words.take_word(Address::T) {
            let tool = tool.whole().ok_or("T is not a whole number")?;
            self.next_tool = Some(tool);
            let changes = |word: &&Word| word.address == Address::M && word.whole() == Some(6);
            if !words.all.iter().flatten().any(changes) {
                if self.from == Source::Dgshape {
                    return Err("T without M06 changes no tool. Write M06 VA_ at the change.".to_owned());
                }
                // T without M06 only turns the magazine
                self.note = Some(format!("T{tool} is called"));
            }
        }
        while let Some(word) = words.take_word(Address::M) {
            let number = word.whole().ok_or_else(|| Self::no_equal(word))?;
            let text = match number {
                6 => {
                    let tool = self.next_tool.take().ok_or("M06 has no T. Write M06 VA_.")?;
                    self.tool = Some(tool);
                    format!("M06 VA{tool}")
                }
                RIGID_TAPPING if self.from == Source::Fanuc => {
                    // in nj, the spindle always turns in step with the thread
                    self.is_rigid = true;
                    continue;
                }
                98 if self.from == Source::Fanuc => {
                    if self.cycle.is_some() {
                        return Err("the positions in the subprogram are holes of the cycle in force. Write G80 before the call, and the cycle in the subprogram.".to_owned());
                    }
                    let called = words.take_word(Address::P).and_then(Word::whole);
                    let program = called.map(|called| called % CALLS_FROM);
                    let program = program.filter(|number| (1000..=9999).contains(number));
                    let program = program
                        .ok_or("the number of a subprogram must be 1000 to 9999. Rename the subprogram.")?;
                    let times = called.map(|called| called / CALLS_FROM);
                    let times = times.filter(|times| *times > 0);
                    let times = times.or_else(|| words.take_word(Address::L).and_then(Word::whole));
                    format!(
                        "M98 P{program}{}",
                        times.map_or_else(String::new, |times| format!(" L{times}"))
                    )
                }
                _ => format!("M{number:02}"),
            };
            match number {
                3 | 4 => self.spindle = Some(number),
                5 => self.spindle = None,
                _ => {}
            }
            let is_before = self.from == Source::Dgshape || BEFORE_MOTION.contains(&number);
            if is_before { &mut *before } else { &mut *behind }.push(text);
        }
        Ok(())
    }

    fn dwell(&self, words: &mut Words<'_>) -> Result<String, String> {
        let seconds = match (words.take_word(Address::X), words.take_word(Address::P)) {
            (Some(seconds), None) => self.seconds(seconds)?,
            (None, Some(dwell)) => self.dwell_of_p(dwell)?,
            _ => return Err("the dwell has no time".to_owned()),
        };
        Ok(format!("G04 X{}", shown(seconds)))
    }

    /// Converts G43 and G49. In dialect dgshape, G43 or G49 without axis words moves Z by the change of the
    /// offset.
    fn length(&mut self, words: &mut Words<'_>, on: bool) -> Result<Vec<String>, String> {
        let code = if on { "G43" } else { "G49" };
        if on {
            self.own_tool(words.take_word(Address::H), "H")?;
        }
        let offset = self.tool.filter(|_| on);
        let changes = std::mem::replace(&mut self.offset, offset) != offset;
        if words.has(&POSITIONS) {
            let mut lines = self.motion(words, &Codes::default())?;
            if let Some(first) = lines.first_mut() {
                *first = format!("{code} {first}");
            }
            return Ok(lines);
        }
        if self.from == Source::Fanuc || !changes {
            return Ok(vec![code.to_owned()]);
        }
        let motion = if self.motion == "G00" { "G00" } else { "G01" };
        let back = (self.absolute == Some(true)).then(|| "G90".to_owned());
        let moves = [code.to_owned(), format!("G91 {motion} Z0")];
        Ok(moves.into_iter().chain(back).collect())
    }

    fn motion(&mut self, words: &mut Words<'_>, codes: &Codes) -> Result<Vec<String>, String> {
        let may_be_arc = !matches!(self.motion, "G00" | "G01");
        let centre = [Address::I, Address::J, Address::K, Address::R];
        let moves = words.has(&POSITIONS) || (may_be_arc && words.has(&centre));
        if !moves {
            return Ok(if codes.names_motion {
                vec![self.motion.to_owned()]
            } else {
                Vec::new()
            });
        }
        if words.has(&[Address::A]) && self.motion != "G00" {
            return Err(
                "F of a motion of A is the speed of its surface in the source. Write the motion with F for nj."
                    .to_owned(),
            );
        }
        let mut parts: Vec<String> = Some(self.motion.to_owned())
            .filter(|motion| !motion.is_empty())
            .into_iter()
            .collect();
        parts.extend(self.positions(words)?);
        if may_be_arc {
            for address in centre {
                if let Some(word) = words.take_word(address) {
                    parts.push(format!("{}{}", address.text(), shown(self.value(word)?)));
                }
            }
        }
        if codes.stops_exactly {
            // after the positions, G09 stops at the end of the motion
            parts.push("G09".to_owned());
        }
        Ok(vec![parts.join(" ")])
    }
}

/// Result of reading the G codes of a block.
#[derive(Default)]
struct Codes {
    action: Action,
    names_motion: bool,
    begins_cycle: bool,
    /// True if the motion ends with an exact stop.
    stops_exactly: bool,
    /// M code that starts the spindle again after a tapping cycle.
    ends_tapping: Option<u32>,
}

/// Action that the G codes of a block select.
#[derive(Default)]
enum Action {
    #[default]
    Motion,
    Dwell,
    /// Return to a reference point: G28 or G30.
    Reference(&'static str),
    /// Local coordinates: G52.
    Local,
    /// New coordinates for the tool's position: G92.
    Shift,
    /// Motion to a machine position: G53.
    Machine,
    Rotation,
    Scaling,
    /// Mirroring: on by G51.1, off by G50.1.
    Mirroring(bool),
    /// Tool length offset: on or off.
    Length(bool),
}
