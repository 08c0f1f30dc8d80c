use plc_api::{AuxOutput, SequenceProgram};

async fn clamp(_output: AuxOutput) -> Result<(), String> {
    Err("the clamp is stuck".to_owned())
}

fn main() {
    let _ = SequenceProgram::new().on(12, clamp);
}
