use plc_api::{Alarm, AuxOutput, SequenceProgram};

async fn clamp(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on("M12", clamp);
}
