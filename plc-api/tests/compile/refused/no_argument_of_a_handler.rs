use plc_api::{Alarm, MCode, SequenceProgram};

const CLAMP: MCode = MCode::new(12, "clamp");

async fn clamp(_force: f64) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(CLAMP, clamp);
}
