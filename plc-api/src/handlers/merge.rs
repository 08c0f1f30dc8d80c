//! Sequence programs composed of other sequence programs.

use std::ops::RangeInclusive;

use super::{Companion, SequenceProgram};

impl SequenceProgram {
    /// Adds all handlers, checks, states, scans, tasks and levels of another program, such as the program of
    /// a part of the machine in a separate crate. [`SequenceProgram::run`] refuses two handlers of one M
    /// code, two states of one type, and two different [`handler_id`](SequenceProgram::handler_id)s.
    ///
    /// If one of the programs sets [`on_redelivery`](SequenceProgram::on_redelivery), the stricter setting of
    /// both programs applies; a program without the setting has [`Redelivery::Ask`](crate::Redelivery::Ask).
    /// A call of `on_redelivery` after the last `merge` sets it for all merged programs.
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

    /// Adds another program as [`merge`](SequenceProgram::merge) does, but moves its M codes into this range.
    /// The lowest M code of that program becomes the first of the range, and the other M codes keep their
    /// distance to the lowest. Thus the program of one device can serve several devices of the same kind. The
    /// added part keeps its own [`state`](SequenceProgram::state)s and its own
    /// [`on_redelivery`](SequenceProgram::on_redelivery).
    ///
    /// ```
    /// # use plc_api::{Alarm, AuxOutput, SequenceProgram};
    /// # #[derive(Clone)] struct Valve(u8);
    /// # async fn close(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// # async fn open(_output: AuxOutput) -> Result<(), Alarm> { Ok(()) }
    /// /// M10 closes a clamp, M11 opens it.
    /// fn clamp(valve: u8) -> SequenceProgram {
    ///     SequenceProgram::new().on(10, close).on(11, open).state(Valve(valve))
    /// }
    ///
    /// let program = SequenceProgram::new().merge_at(10..=11, clamp(1)).merge_at(20..=21, clamp(2));
    /// assert_eq!(program.check(), Ok(()));
    /// let codes: Vec<u16> = program.served().serves.iter().map(|one| one.m).collect();
    /// assert_eq!(codes, [10, 11, 20, 21]);
    /// ```
    ///
    /// [`SequenceProgram::run`] refuses a part without handlers, and a moved M code outside of the range.
    #[must_use]
    pub fn merge_at(mut self, codes: RangeInclusive<u16>, part: Self) -> Self {
        self.table.merge_at(&codes, part.table, part.how.on_redelivery);
        self.adopt(part.companions, part.how.takes_over, part.handler_id);
        self
    }

    fn adopt(&mut self, companions: Vec<Companion>, takes_over: bool, handler_id: Option<String>) {
        if let (Some(id), Some(other)) = (&self.handler_id, &handler_id)
            && id != other
        {
            self.add_mistake(format!("merge() got two program names, {id:?} and {other:?}"));
        }
        self.companions.extend(companions);
        self.how.takes_over |= takes_over;
        self.handler_id = self.handler_id.take().or(handler_id);
    }
}
