//! What a scan tells and asks the operator.

use super::asked::Asked;
use super::image::Image;
use crate::alarm::Alarm;
use crate::types::CoordinateSystemNumber;

/// Alarms and questions, which are written in every scan while they count.
impl Image {
    /// Raises an alarm while a level is on, in a coordinate system or, with `None`, in the whole machine. Write it in every
    /// scan. It is raised once; it stays after the level until a reset, and a reset while the level is on does not last: the alarm
    /// comes again. One alarm of a code at a time in each place.
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
    /// An alarm that is not of [`Alarm::user`], or without a text, is refused ([`Image::refusals`]).
    pub fn set_alarm(&mut self, cs: impl Into<Option<CoordinateSystemNumber>>, level: bool, alarm: Alarm) {
        self.writes
            .alarms
            .insert((cs.into(), alarm.number), (level, alarm));
    }

    /// Asks the operator about an M code, and gives the answer once it is there: one of the choices. Write it in every scan until
    /// then; a scan that does not write it takes the question back. While the M code is off it asks nothing. An M code has one
    /// question at a time, the last that is written.
    ///
    /// `text` has 1 to 200 characters; there are 1 to 8 different choices of 1 to 40 characters. Others are refused
    /// ([`Image::refusals`]).
    ///
    /// ```
    /// # use plc_api::{Alarm, Params, SequenceProgram, fake::FakePort, handshake::Closed, scan::Image};
    /// # use std::time::Duration;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// let program = SequenceProgram::new().scan(80, Duration::from_millis(10), |image: &mut Image| {
    ///     match image.ask(1, 80, "Is the part clean?", ["yes", "no"]).as_deref() {
    ///         Some("yes") => image.reset(1, 80),
    ///         Some(_) => image.fail(1, 80, Alarm::user(3, "the operator says that the part is not clean")),
    ///         None => {} // M80 is off, or nobody has answered yet
    ///     }
    /// });
    /// # tokio::spawn(async move { program.run(&plc).await });
    /// # let seq = fake.put_out(1, 80, Params::default());
    /// # fake.advance(Duration::from_millis(50)).await;
    /// # let mill = fake.plc().coordinate_system(1);
    /// # mill.answer(&mill.question().await?, "yes").await?;
    /// # fake.advance(Duration::from_millis(50)).await;
    /// # assert_eq!(fake.closed(1, seq), Some(Closed::Reset));
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
        let asked = Asked {
            text: text.into(),
            choices: choices.into_iter().map(Into::into).collect(),
        };
        let said = self.said.get(&(cs, m)).filter(|(of, _)| *of == asked);
        let said = said.map(|(_, choice)| choice.clone());
        self.writes.questions.insert((cs, m), (output, asked));
        said
    }
}
