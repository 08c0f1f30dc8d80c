use plc_api::MCode;

const TOO_HIGH: MCode = MCode::new(192, "clamp");
const OF_THE_RUNTIME: MCode = MCode::new(30, "end");

fn main() {
    println!("{TOO_HIGH} {OF_THE_RUNTIME}");
}
