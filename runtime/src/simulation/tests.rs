//! A machine in simulated time whose parts are visible to the tests of this crate.

use plc_api::Plc;
use plc_protocol::types::request::typed::WriteProgram;
use tandem_store::journal::Journal;

use super::{SimulationOptions, run};
use crate::{Config, Runtime};

/// Runs `act` with the demo machine and these programs.
pub(crate) fn play<T>(
    journal: Journal,
    programs: &[(u16, &str)],
    act: impl AsyncFnOnce(&Runtime, Plc) -> T,
) -> T {
    let mut machine = Config::demo().resolve().unwrap();
    for system in &mut machine.coordinate_systems {
        system.programs.clear();
    }
    let played = run(async {
        let options = SimulationOptions::default();
        let runtime = Runtime::start_simulated(machine, journal, options).unwrap();
        let plc = Plc::in_process(runtime.port());
        for (number, text) in programs {
            let written = plc.port().ask(WriteProgram(*number, (*text).to_owned())).await;
            written.unwrap();
        }
        let done = act(&runtime, plc).await;
        runtime.shutdown().await;
        done
    });
    played.unwrap()
}
