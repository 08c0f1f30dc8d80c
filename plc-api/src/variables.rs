//! P and Q variables, from the point of view of a sequence program.

use plc_protocol::error::Result;
use plc_protocol::types::data::VariableArea;
use plc_protocol::types::refusal::{Refusal, RefusalCode};
use plc_protocol::types::request::typed::{ReadVariables, WriteVariables};

use crate::plc::Plc;

/// The P variables of a machine ([`Plc::variables`]) or the Q variables of a coordinate system
/// ([`CoordinateSystem::variables`](crate::CoordinateSystem::variables)).
///
/// An NC program reads a variable when the block is interpreted, ahead of the motion (D16). The block after
/// an `after_motion` M code reads the values that the handler of this M code wrote before the reset. Values
/// persist across starts of the runtime; they are on disk at most 100 ms after they were set.
///
/// ```
/// # #[tokio::main(flavor = "current_thread")] async fn main() -> plc_api::Result<()> {
/// let plc = plc_api::fake::FakePort::new([1]).plc();
/// let q = plc.coordinate_system(1).variables();
/// q.write(10, &[1.5, -2.0]).await?;
/// assert_eq!(q.read(10, 2).await?, [1.5, -2.0]);
/// plc.variables().set(100, 7.0).await?;
/// assert_eq!(plc.variables().get(100).await?, 7.0);
/// # Ok(()) }
/// ```
#[derive(Debug, Clone)]
pub struct Variables {
    plc: Plc,
    area: VariableArea,
}

impl Variables {
    pub(crate) fn new(plc: Plc, area: VariableArea) -> Self {
        Self { plc, area }
    }

    pub(crate) fn plc(&self) -> &Plc {
        &self.plc
    }

    pub(crate) fn area(&self) -> VariableArea {
        self.area
    }

    /// Returns the value of one variable. The value may be infinite or NaN, like any result of an NC program
    /// (D07).
    ///
    /// # Errors
    /// Fails if the variable or the coordinate system does not exist, or the machine cannot be reached.
    pub async fn get(&self, number: u32) -> Result<f64> {
        let values = self.read(number, 1).await?;
        let none = || Refusal::new(RefusalCode::Invalid, "the machine gave no value").into();
        values.first().copied().ok_or_else(none)
    }

    /// Sets one variable.
    ///
    /// # Errors
    /// Fails if the variable or the coordinate system does not exist, or the machine cannot be reached.
    pub async fn set(&self, number: u32, value: f64) -> Result<()> {
        self.write(number, &[value]).await
    }

    /// Returns the values of `count` variables (1 to 1024) from number `from` on. All of them are read at one
    /// moment: no write happens in between.
    ///
    /// # Errors
    /// Fails if a variable of the range does not exist, `count` is more than 1024, or the machine cannot be
    /// reached.
    pub async fn read(&self, from: u32, count: u32) -> Result<Vec<f64>> {
        let request = ReadVariables {
            area: self.area,
            from,
            count,
            meta: None,
        };
        self.plc.request(request).await
    }

    /// Writes 1 to 1024 variables from number `from` on. Either all of them are written, between two blocks
    /// of any NC program, or none.
    ///
    /// # Errors
    /// Fails if a variable of the range does not exist, there are more than 1024 values, or the machine
    /// cannot be reached. In these cases nothing was written. If the connection broke, it is unknown whether
    /// the variables were written.
    pub async fn write(&self, from: u32, values: &[f64]) -> Result<()> {
        let request = WriteVariables {
            area: self.area,
            from,
            values: values.to_vec(),
            meta: None,
        };
        self.plc.request(request).await.map(|_| ())
    }
}
