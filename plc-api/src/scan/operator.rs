//! Alarms and questions of a scan to the operator.

use plc_protocol::alarm::Alarm;
use plc_protocol::types::CoordinateSystemNumber;

use super::image::Image;
use super::scan_question::ScanQuestion;

/// Methods for alarms and questions. Call such a method in every scan while the alarm or question applies.
impl Image {
    /// Raises an alarm when a level turns on, in a coordinate system or, with `None`, in the whole machine.
    /// Write the level in every scan. The alarm stays active until a reset, even if the level turns off. If
    /// the level is still on after a reset, the alarm is raised again. Each coordinate system, and the whole
    /// machine, has at most one alarm of the same code at a time.
    ///
    /// ```
    /// # use plc_api::{Alarm, SequenceProgram, fake::FakePort, scan::Image};
    /// # use std::time::Duration;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # fn air_is_low() -> bool { true }
    /// let program = SequenceProgram::new().scan([], Duration::from_millis(10), |image: &mut Image| {
    ///     image.set_alarm(None, air_is_low(), Alarm::user(20, "the air pressure is low"));
    /// });
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # fake.advance(Duration::from_millis(50)).await;
    /// # assert_eq!(fake.plc().alarms().await?.len(), 1);
    /// # Ok(()) }
    /// ```
    ///
    /// An alarm that was not created by [`Alarm::user`], or has no text, is refused ([`Image::refusals`]).
    pub fn set_alarm(&mut self, cs: impl Into<Option<CoordinateSystemNumber>>, level: bool, alarm: Alarm) {
        self.writes
            .alarms
            .insert((cs.into(), alarm.number), (level, alarm));
    }

    /// Asks the operator about an M code. Returns `None` until the operator answers, then the choice of the
    /// operator. Call this method in every scan until the answer arrives; a scan without the call withdraws
    /// the question. No effect while the M code is off. An M code has one question at a time: the last
    /// question that the scan writes.
    ///
    /// `text` has 1 to 200 characters. A question has 1 to 8 different choices of 1 to 40 characters. Any
    /// other question is refused ([`Image::refusals`]).
    ///
    /// ```
    /// # use plc_api::{Alarm, Params, SequenceProgram, fake::{FakePort, OutputOutcome}, scan::Image};
    /// # use std::time::Duration;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// let program = SequenceProgram::new().scan(80, Duration::from_millis(10), |image: &mut Image| {
    ///     match image.ask(1, 80, "Is the part clean?", ["yes", "no"]).as_deref() {
    ///         Some("yes") => image.reset(1, 80),
    ///         Some(_) => image.fail(1, 80, Alarm::user(3, "the operator says that the part is not clean")),
    ///         None => {} // M80 is off, or the operator has not answered yet
    ///     }
    /// });
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # let seq = fake.issue_output(1, 80, Params::default());
    /// # fake.advance(Duration::from_millis(50)).await;
    /// # let mill = fake.plc().coordinate_system(1);
    /// # mill.answer(&mill.question().await?, "yes").await?;
    /// # fake.advance(Duration::from_millis(50)).await;
    /// # assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    /// # Ok(()) }
    /// ```
    pub fn ask<C: Into<String>>(
        &mut self,
        cs: CoordinateSystemNumber,
        m: u16,
        text: impl Into<String>,
        choices: impl IntoIterator<Item = C>,
    ) -> Option<String> {
        let output = self.output(cs, m)?.clone();
        let asked = ScanQuestion {
            text: text.into(),
            choices: choices.into_iter().map(Into::into).collect(),
        };
        let said = self.operator_answers.get(&(cs, m)).filter(|(of, _)| *of == asked);
        let said = said.map(|(_, choice)| choice.clone());
        self.writes.questions.insert((cs, m), (output, asked));
        said
    }
}
