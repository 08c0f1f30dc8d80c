use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};

async fn clamp(_plc: Plc, _output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(12, clamp);
}
