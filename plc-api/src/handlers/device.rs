//! Handlers that are methods of one device. Only one method of a device runs at a time.

use std::future::Future;
use std::sync::Arc;

use plc_protocol::alarm::Alarm;
use plc_protocol::port::BoxFuture;
use tokio::sync::Mutex;

use super::SequenceProgram;
use crate::aux_output::AuxOutput;
use crate::m_codes::{ByNumber, MCodes};
use crate::plc::Plc;

/// An async method of a device with the arguments `(&mut self, AuxOutput)` or `(&mut self, AuxOutput, Plc)`.
#[diagnostic::on_unimplemented(
    message = "this is no handler of the device `{D}`",
    label = "no method of `{D}` that handles an M code",
    note = "write an `async fn` of `(&mut self, AuxOutput)` or `(&mut self, AuxOutput, Plc)` that gives `Result<(), Alarm>`, and name it, such as `Magazine::change`: a closure is none",
    note = "its future is `Send`: it keeps no `Rc`, `RefCell` or guard of a lock over an `.await`"
)]
pub trait DeviceHandler<'a, D, Arguments>: Send + Sync + 'static {
    /// Starts the work of the handler, and returns its future.
    fn call(&self, device: &'a mut D, output: AuxOutput, plc: Plc) -> BoxFuture<'a, Result<(), Alarm>>;
}

impl<'a, D: 'a, F, Work> DeviceHandler<'a, D, (AuxOutput, Plc)> for F
where
    F: Fn(&'a mut D, AuxOutput, Plc) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'a,
{
    fn call(&self, device: &'a mut D, output: AuxOutput, plc: Plc) -> BoxFuture<'a, Result<(), Alarm>> {
        Box::pin(self(device, output, plc))
    }
}

impl<'a, D: 'a, F, Work> DeviceHandler<'a, D, (AuxOutput,)> for F
where
    F: Fn(&'a mut D, AuxOutput) -> Work + Send + Sync + 'static,
    Work: Future<Output = Result<(), Alarm>> + Send + 'a,
{
    fn call(&self, device: &'a mut D, output: AuxOutput, _plc: Plc) -> BoxFuture<'a, Result<(), Alarm>> {
        Box::pin(self(device, output))
    }
}

/// Builder that adds handlers for the M codes of a device, within [`SequenceProgram::device`].
#[derive(Debug)]
pub struct Device<D, Scope> {
    device: Arc<Mutex<D>>,
    program: SequenceProgram<Scope>,
}

impl<D: Send + 'static, Scope> Device<D, Scope> {
    /// Adds a method of the device as the handler of one or several M codes, by number or by name.
    #[must_use]
    pub fn on<A, By>(
        mut self,
        codes: impl MCodes<By>,
        handler: impl for<'a> DeviceHandler<'a, D, A>,
    ) -> Self {
        let (device, handler) = (Arc::clone(&self.device), Arc::new(handler));
        let call = move |output: AuxOutput, plc: Plc| {
            let (device, handler) = (Arc::clone(&device), Arc::clone(&handler));
            async move {
                let mut device = device.lock().await;
                handler.call(&mut device, output, plc).await
            }
        };
        self.program.add::<(AuxOutput, Plc), ByNumber, By>(codes, call);
        self
    }
}

impl<Scope> SequenceProgram<Scope> {
    /// Adds a device of the machine, such as a magazine. The device owns its state, and its methods are the
    /// handlers of its M codes. Only one method of a device runs at a time: further calls wait in the order
    /// in which they were started.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
    /// struct Magazine {
    ///     pocket: u8,
    /// }
    ///
    /// impl Magazine {
    ///     async fn change(&mut self, output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    ///         let wanted = output.params().a().ok_or(Alarm::user(1, "M06 needs VA"))? as u8;
    ///         while self.pocket != wanted {
    ///             self.pocket = self.pocket % 8 + 1;
    ///             plc.sleep(Duration::from_millis(500)).await;
    ///         }
    ///         Ok(())
    ///     }
    ///
    ///     async fn home(&mut self, _output: AuxOutput) -> Result<(), Alarm> {
    ///         self.pocket = 1;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let program = SequenceProgram::new()
    ///     .device(Magazine { pocket: 1 }, |magazine| magazine.on(6, Magazine::change).on(7, Magazine::home));
    /// # assert_eq!(program.check(), Ok(()));
    /// ```
    ///
    /// If the output of a method is cancelled, the method ends at its current await point. The next method
    /// receives the device in the state in which the cancelled method left it.
    #[must_use]
    pub fn device<D: Send + 'static>(
        self,
        device: D,
        build: impl FnOnce(Device<D, Scope>) -> Device<D, Scope>,
    ) -> Self {
        let device = Arc::new(Mutex::new(device));
        build(Device {
            device,
            program: self,
        })
        .program
    }
}
