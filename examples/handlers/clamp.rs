//! A handler that is independent of the transport: M12 VA closes a clamp with a force of VA kN.

use std::time::Duration;

use plc_api::{Alarm, AuxOutput, Plc};

const FORCE_MAX_KN: f64 = 20.0;

pub async fn clamp(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let force_kn = output
        .params()
        .a()
        .ok_or(Alarm::user(1, "M12 needs VA: the clamping force in kN"))?;
    if !(0.0..=FORCE_MAX_KN).contains(&force_kn) {
        let text = format!("a clamping force of {force_kn} kN is not in 0 to {FORCE_MAX_KN}");
        return Err(Alarm::user(2, text));
    }
    println!(
        "M{} from line {}: closing with {force_kn} kN",
        output.m(),
        output.line()
    );
    for percent in [0.0, 50.0] {
        output.progress("the clamp closes", percent).await?;
        plc.sleep(Duration::from_millis(200)).await;
    }
    println!("M{}: closed", output.m());
    Ok(())
}
