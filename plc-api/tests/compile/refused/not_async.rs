use plc_api::{Alarm, AuxOutput, MCode, SequenceProgram};

const CLAMP: MCode = MCode::new(12, "clamp");

fn clamp(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(CLAMP, clamp);
}
