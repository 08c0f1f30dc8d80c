use plc_api::{Alarm, Plc, SequenceProgram, Va};

async fn clamp(Va(_force): Va<f64>, _plc: Plc) -> Result<(), Alarm> {
    Ok(())
}

fn main() {
    let _ = SequenceProgram::new().on(12, clamp);
}
