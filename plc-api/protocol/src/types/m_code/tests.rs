use super::*;

fn clamp() -> MCodeDeclaration {
    let json = r#"{"m":12,"name":"clamp","params":{
            "A":{"name":"force","unit":"kN","min":1,"max":20},
            "VB":{"name":"side","min":1,"max":2,"whole":true,"optional":true}}}"#;
    serde_json::from_str(json).unwrap()
}

fn why(declaration: &MCodeDeclaration, a: Option<f64>, b: Option<f64>, c: Option<f64>) -> String {
    let params = Params {
        a,
        b,
        c,
        ..Params::default()
    };
    let fault = declaration.check(&params).err();
    fault.map_or_else(String::new, |fault| fault.text)
}

#[test]
fn what_is_declared_is_taken_with_its_bounds() {
    for (a, b) in [(1.0, None), (20.0, Some(1.0)), (7.25, Some(2.0))] {
        assert_eq!(why(&clamp(), Some(a), b, None), "");
    }
}

#[test]
fn a_whole_number_is_one_that_a_program_has_calculated() {
    let pocket = ParamDeclaration {
        whole: true,
        ..ParamDeclaration::default().within(Some(1.0), Some(3.0))
    };
    for (number, is_taken) in [
        (3.0, true),
        (0.1 * 30.0, true),
        (1.0 - 1e-12, true),
        (2.001, false),
        (4.0, false),
    ] {
        assert_eq!(pocket.takes(number), is_taken, "{number}");
    }
}

#[test]
fn a_fault_names_m_code_parameter_value_and_what_to_write() {
    let cases = [
        (
            Some(50.0),
            None,
            None,
            "M12 clamp: VA (force) is 50 kN; write 1 to 20 kN",
        ),
        (
            Some(f64::NAN),
            None,
            None,
            "M12 clamp: VA (force) is NaN kN; write 1 to 20 kN",
        ),
        (None, None, None, "M12 clamp needs VA (force, 1 to 20 kN)"),
        (
            Some(5.0),
            Some(1.5),
            None,
            "M12 clamp: VB (side) is 1.5; write a whole number, 1 to 2",
        ),
        (
            Some(5.0),
            None,
            Some(0.0),
            "M12 clamp takes no VC; it takes VA (force, 1 to 20 kN), VB (side, a whole number, 1 to 2; may be left out)",
        ),
    ];
    for (a, b, c, text) in cases {
        assert_eq!(why(&clamp(), a, b, c), text);
    }
}

#[test]
fn what_a_variable_holds_is_not_judged_and_that_it_is_there_is() {
    let mut given = [GivenParam::Absent; 8];
    given[0] = GivenParam::Variable;
    assert_eq!(clamp().faults(given), []);
    given[2] = GivenParam::Variable;
    let faults = clamp().faults(given);
    assert_eq!(faults.len(), 1);
    assert_eq!(faults[0].letter, ParamLetter::C);
}

#[test]
fn without_params_everything_is_taken_and_with_empty_ones_nothing() {
    let any = MCodeDeclaration {
        m: 8,
        ..MCodeDeclaration::default()
    };
    assert_eq!(why(&any, Some(1.0), None, None), "");
    let none = MCodeDeclaration {
        params: Some(DeclaredParams::new()),
        ..any
    };
    assert_eq!(why(&none, None, None, None), "");
    assert_eq!(
        why(&none, Some(1.0), None, None),
        "M08 takes no VA; it takes no parameters"
    );
}

#[test]
fn a_range_is_told_in_words() {
    let range = |min, max, whole, unit: Option<&str>| {
        let unit = unit.map(str::to_owned);
        ParamDeclaration {
            unit,
            min,
            max,
            whole,
            ..ParamDeclaration::default()
        }
        .range_text()
    };
    assert_eq!(range(Some(0.5), None, false, Some("bar")), "0.5 bar or more");
    assert_eq!(range(None, Some(3.0), true, None), "a whole number, 3 or less");
    assert_eq!(range(None, None, false, Some("mm")), "a number in mm");
    assert_eq!(range(None, None, true, None), "a whole number");
}

#[test]
fn what_cannot_be_is_a_mistake() {
    let with = |param: ParamDeclaration| MCodeDeclaration {
        params: Some([(ParamLetter::B, param)].into()),
        ..clamp()
    };
    let long = Some("x".repeat(DECLARED_NAME_MAX + 1));
    let cases = [
        (
            MCodeDeclaration { m: 192, ..clamp() },
            "M192: M codes are 0 to 191",
        ),
        (
            MCodeDeclaration {
                name: long.clone(),
                ..clamp()
            },
            "M12: name: write 1 to 40 characters",
        ),
        (
            with(ParamDeclaration {
                name: long,
                ..ParamDeclaration::default()
            }),
            "M12 VB: name: write 1 to 40 characters",
        ),
        (
            with(ParamDeclaration::in_unit("")),
            "M12 VB: unit: write 1 to 16 characters",
        ),
        (
            with(ParamDeclaration::default().within(Some(2.0), Some(1.0))),
            "M12 VB: min 2 is above max 1",
        ),
        (
            with(ParamDeclaration::default().within(Some(f64::NAN), None)),
            "M12 VB: min and max: write numbers",
        ),
    ];
    assert_eq!(clamp().mistake(), Ok(()));
    for (declaration, text) in cases {
        assert_eq!(declaration.mistake(), Err(text.to_owned()));
    }
}
