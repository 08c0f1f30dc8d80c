use plc_api::Params;

#[derive(Params)]
struct WithoutLetter {
    force: f64,
}

#[derive(Params)]
struct HalfOpen {
    #[va(1..20)]
    force: f64,
}

#[derive(Params)]
struct Optional {
    #[va(optional)]
    force: f64,
}

#[derive(Params)]
struct Twice {
    #[va]
    force: f64,
    #[va]
    side: u8,
}

#[derive(Params)]
struct TwoLetters {
    #[va]
    #[vb]
    force: f64,
}

#[derive(Params)]
struct Foreign {
    #[va(unit = "kN")]
    force: f64,
}

#[derive(Params)]
struct Tuple(f64);

#[derive(Params)]
enum Choice {
    Left,
}

fn main() {}
