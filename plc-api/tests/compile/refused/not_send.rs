use std::rc::Rc;
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};

async fn clamp(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let force = Rc::new(5.0);
    plc.sleep(Duration::from_secs(1)).await;
    drop(force);
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(12, clamp);
}
