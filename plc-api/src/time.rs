//! Time limits and intervals on the machine's clock.

use std::future::Future;
use std::time::Duration;

use plc_protocol::error::{Error, Result};

use crate::plc::Plc;

/// Shortest period of an interval. Reason: the clocks have a resolution of 1 ms.
pub const INTERVAL_MIN: Duration = Duration::from_millis(1);

impl Plc {
    /// Runs work with a time limit on the machine's clock, which is simulated in a simulation. At the limit
    /// the work is dropped at its current await point.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use plc_api::{Alarm, AuxOutput, Params, Plc, SequenceProgram, fake::{FakePort, OutputOutcome}};
    /// # async fn clamp_is_closed() { std::future::pending().await }
    /// async fn clamp(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///     let closed = plc.timeout(Duration::from_secs(3), clamp_is_closed()).await;
    ///     closed.map_err(|_| Alarm::user(10, "the clamp does not close"))
    /// }
    /// # #[tokio::main(flavor = "current_thread")] async fn main() {
    /// # let fake = FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # tokio::spawn(async move { SequenceProgram::new().on(10, clamp).run(&plc).await });
    /// # let seq = fake.issue_output(1, 10, Params::default());
    /// # fake.advance(Duration::from_secs(3)).await;
    /// # assert!(matches!(fake.closed(1, seq), Some(OutputOutcome::Failed { .. })));
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::TimedOut`] if the work is not finished at the limit.
    pub async fn timeout<T>(&self, limit: Duration, work: impl Future<Output = T>) -> Result<T> {
        tokio::select! {
            // work that finishes exactly at the limit has succeeded
            biased;
            done = work => Ok(done),
            () = self.sleep(limit) => Err(Error::TimedOut { limit }),
        }
    }

    /// Creates an interval that ticks at a fixed period on the machine's clock. The first tick is now; the
    /// period is at least 1 ms.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # #[tokio::main(flavor = "current_thread")] async fn main() {
    /// # let fake = plc_api::fake::FakePort::new([1]);
    /// # let plc = fake.plc();
    /// # let task = tokio::spawn(async move {
    /// let mut second = plc.interval(Duration::from_secs(1));
    /// for _ in 0..3 {
    ///     second.tick().await; // at 0, 1 and 2 s
    /// }
    /// # plc.now_s()
    /// # });
    /// # fake.advance(Duration::from_secs(5)).await;
    /// # assert_eq!(task.await.unwrap(), 2.0);
    /// # }
    /// ```
    pub fn interval(&self, period: Duration) -> Interval {
        Interval {
            plc: self.clone(),
            period_s: period.max(INTERVAL_MIN).as_secs_f64(),
            next_s: self.now_s(),
        }
    }
}

/// A sequence of ticks at a fixed period, created by [`Plc::interval`].
#[derive(Debug)]
pub struct Interval {
    plc: Plc,
    period_s: f64,
    next_s: f64,
}

impl Interval {
    /// Waits for the next tick. If ticks were missed meanwhile, they are skipped: the next tick is at the
    /// next full period. Cancellation safe.
    pub async fn tick(&mut self) {
        let left_s = (self.next_s - self.plc.now_s()).max(0.0);
        let left = Duration::try_from_secs_f64(left_s).unwrap_or(Duration::MAX);
        self.plc.sleep(left).await;
        let missed = ((self.plc.now_s() - self.next_s) / self.period_s)
            .floor()
            .max(0.0);
        self.next_s += self.period_s * (missed + 1.0);
    }
}
