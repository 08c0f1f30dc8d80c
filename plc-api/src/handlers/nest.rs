//! Sequence programs composed of other sequence programs.

use std::ops::RangeInclusive;

use super::{Companion, SequenceProgram};

impl SequenceProgram {
    /// Adds another program, such as that of a part of the machine with a crate of its own: its handlers, checks, states, scans,
    /// tasks and levels. [`SequenceProgram::run`] refuses two handlers of one M code, two states of one type, and two different
    /// [`handler_id`](SequenceProgram::handler_id)s.
    ///
    /// Of two answers to [`on_redelivery`](SequenceProgram::on_redelivery) the stricter counts, where a program that says nothing
    /// says [`Redelivery::Ask`](crate::Redelivery::Ask); what is said after the last `merge` counts for all.
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, SequenceProgram};
    /// # async fn on(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn off(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn clamp(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// fn coolant() -> SequenceProgram {
    ///     SequenceProgram::new().on(8, on).on(9, off)
    /// }
    ///
    /// let program = SequenceProgram::new().handler_id("mill").on(10, clamp).merge(coolant());
    /// assert_eq!(program.check(), Ok(()));
    /// assert!(program.merge(coolant()).check().is_err());
    /// ```
    #[must_use]
    pub fn merge(mut self, other: Self) -> Self {
        self.how.on_redelivery = match (self.how.on_redelivery, other.how.on_redelivery) {
            (None, None) => None,
            (one, other) => one.unwrap_or_default().max(other.unwrap_or_default()).into(),
        };
        self.table.merge(other.table);
        self.adopt(other.companions, other.how.takes_over, other.handler_id);
        self
    }

    /// Adds another program as [`merge`](SequenceProgram::merge) does, at M codes of this range: the lowest M code that it serves becomes the
    /// first of the range, and the others follow at their distance. So a part that was written once serves two devices. It keeps its
    /// own [`state`](SequenceProgram::state)s and its own [`on_redelivery`](SequenceProgram::on_redelivery).
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, SequenceProgram, State};
    /// # #[derive(Clone)] struct Valve(u8);
    /// # async fn close(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn open(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// /// M10 closes a clamp, M11 opens it.
    /// fn clamp(valve: u8) -> SequenceProgram {
    ///     SequenceProgram::new().on(10, close).on(11, open).state(Valve(valve))
    /// }
    ///
    /// let program = SequenceProgram::new().nest(10..=11, clamp(1)).nest(20..=21, clamp(2));
    /// assert_eq!(program.check(), Ok(()));
    /// let codes: Vec<u16> = program.served().serves.iter().map(|one| one.m).collect();
    /// assert_eq!(codes, [10, 11, 20, 21]);
    /// ```
    ///
    /// [`SequenceProgram::run`] refuses a part without handlers, and an M code that would be outside of the range.
    #[must_use]
    pub fn nest(mut self, codes: RangeInclusive<u16>, part: Self) -> Self {
        self.table.nest(&codes, part.table, part.how.on_redelivery);
        self.adopt(part.companions, part.how.takes_over, part.handler_id);
        self
    }

    fn adopt(&mut self, companions: Vec<Companion>, takes_over: bool, handler_id: Option<String>) {
        if let (Some(id), Some(other)) = (&self.handler_id, &handler_id)
            && id != other
        {
            self.mistake(format!("merge() got programs of two names, {id:?} and {other:?}"));
        }
        self.companions.extend(companions);
        self.how.takes_over |= takes_over;
        self.handler_id = self.handler_id.take().or(handler_id);
    }
}
