use super::*;
use tandem_model::Axis;

/// Returns the tables of a machine with X, Y, Z in coordinate system 1 and X, Z in coordinate system 2.
pub(crate) fn tables() -> Tables {
    let tool = |length, radius| Tool { length, radius };
    Tables::new(TableSettings {
        tools: [(1, tool(80.0, 5.0)), (2, tool(95.0, 3.0))].into(),
        axes: [
            (1, AxisSet::from_iter([Axis::X, Axis::Y, Axis::Z])),
            (2, AxisSet::from_iter([Axis::X, Axis::Z])),
        ]
        .into(),
        work_offsets: [1, 2].map(|cs| (cs, WorkOffsets([AxisVector::ZERO; 6]))).into(),
    })
}

fn code<T: std::fmt::Debug>(refused: Result<T, Refusal>) -> RefusalCode {
    refused.unwrap_err().code
}

#[test]
fn a_block_sees_all_of_a_range_or_nothing_of_it() {
    let tables = tables();
    let global = tables.variables(1).global;
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for round in 0..2000 {
                let values = [f64::from(round); 1024];
                tables.write_variables(VariableArea::Global, 0, &values).unwrap();
            }
        });
        for _ in 0..2000 {
            let block = tables.read();
            let first = global.get(0);
            assert!((1..1024).all(|number| global.get(number) == first));
            drop(block);
            let read = tables.read_variables(VariableArea::Global, 0, 1024).unwrap();
            assert!(read.windows(2).all(|pair| pair[0].to_bits() == pair[1].to_bits()));
        }
    });
}

#[test]
fn a_range_that_is_refused_writes_nothing() {
    let tables = tables();
    let write = |area, from, values: &[f64]| tables.write_variables(area, from, values);
    assert_eq!(
        code(write(VariableArea::Global, 32_767, &[1.0, 2.0])),
        RefusalCode::Invalid
    );
    assert_eq!(tables.variables(1).global.get(32_767), Some(0.0));
    let q = VariableArea::CoordinateSystem(1);
    assert_eq!(code(write(q, 4095, &[1.0, 2.0])), RefusalCode::Invalid);
    assert_eq!(code(write(q, u32::MAX, &[1.0])), RefusalCode::Invalid);
    assert_eq!(code(write(q, 0, &[])), RefusalCode::Invalid);
    assert_eq!(code(write(q, 0, &[0.0; 1025])), RefusalCode::TooLarge);
    assert_eq!(
        code(write(VariableArea::CoordinateSystem(3), 0, &[1.0])),
        RefusalCode::NotFound
    );
    assert_eq!(code(tables.read_variables(q, 0, u32::MAX)), RefusalCode::TooLarge);
}

#[test]
fn tools_are_changed_as_a_whole_or_not_at_all() {
    let tables = tables();
    let tool = |id, radius, length| ToolData { id, radius, length };
    let change = |tools: Vec<ToolData>, remove: Vec<u16>| {
        tables.change(
            |tables| tables.with_tools(&ToolChange { tools, remove }),
            |_, _| Ok(()),
        )
    };
    let before = tables.tools();
    let infinite = tool(52, 1.0, f64::INFINITY);
    for wrong in [
        tool(0, 1.0, 1.0),
        tool(52, -1.0, 1.0),
        tool(52, f64::NAN, 1.0),
        infinite,
    ] {
        let refused = change(vec![tool(51, 1.0, 1.0), wrong], Vec::new());
        assert_eq!(code(refused), RefusalCode::Invalid, "{wrong:?}");
    }
    let twice = change(vec![tool(51, 1.0, 1.0), tool(51, 2.0, 1.0)], Vec::new());
    assert_eq!(code(twice), RefusalCode::Invalid);
    let missing = change(vec![tool(51, 1.0, 1.0)], vec![60]);
    assert_eq!(code(missing), RefusalCode::NotFound);
    let many = (1..=1001).map(|id| tool(id, 1.0, 1.0)).collect();
    assert_eq!(code(change(many, Vec::new())), RefusalCode::TooLarge);
    assert_eq!(tables.tools(), before);
    change(vec![tool(51, 1.0, 2.0)], Vec::new()).unwrap();
    let at_51 = Tool {
        length: 2.0,
        radius: 1.0,
    };
    assert_eq!(tables.read().tool(51), Some(at_51));
    change(Vec::new(), vec![51]).unwrap();
    assert_eq!(tables.tools(), before);
}

#[test]
fn offsets_and_axes_that_are_not_named_stay() {
    let tables = tables();
    let change = |cs, name: &str, letter: &str, value| {
        let axes = [(letter.to_owned(), value)].into();
        let change = WorkOffsetTable {
            work_offsets: [(name.to_owned(), axes)].into(),
        };
        tables.change(|tables| tables.with_work_offsets(cs, &change), |_, _| Ok(()))
    };
    let mut expected = tables.work_offsets(1).unwrap();
    let other = tables.work_offsets(2).unwrap();
    change(1, "G55", "Y", 12.5).unwrap();
    let g55 = expected.work_offsets.get_mut("G55").unwrap();
    g55.insert("Y".into(), 12.5);
    assert_eq!(tables.work_offsets(1).unwrap(), expected);
    assert_eq!(tables.work_offsets(2).unwrap(), other);
    for (cs, name, letter, value, refused) in [
        (1, "G53", "X", 1.0, RefusalCode::Invalid),
        (1, "G54", "XY", 1.0, RefusalCode::Invalid),
        (1, "G54", "x", 1.0, RefusalCode::Invalid),
        (2, "G54", "Y", 1.0, RefusalCode::Invalid),
        (1, "G54", "X", f64::NAN, RefusalCode::Invalid),
        (3, "G54", "X", 1.0, RefusalCode::NotFound),
    ] {
        assert_eq!(
            code(change(cs, name, letter, value)),
            refused,
            "{cs} {name} {letter} {value}"
        );
    }
    assert_eq!(tables.work_offsets(1).unwrap(), expected);
}

#[test]
fn values_that_undo_a_change_on_disk_include_tools_that_it_adds() {
    let tables = tables();
    let (id, stored) = (77, tables.kept(&tables.read().clone()));
    let added = ToolData {
        id,
        radius: 1.0,
        length: 2.0,
    };
    let change = ToolChange {
        tools: vec![added],
        remove: Vec::new(),
    };
    let mut seen = None;
    let refused = tables.change(
        |tables| tables.with_tools(&change),
        |after, before| {
            seen = Some((after, before));
            Err(Refusal::new(RefusalCode::Expired, "too old"))
        },
    );
    assert_eq!(code(refused), RefusalCode::Expired);
    let (after, before) = seen.unwrap();
    assert!(after.keys().eq(before.keys()), "each written value is undone");
    let known = before.iter().filter(|(key, _)| stored.contains_key(*key));
    assert!(known.eq(stored.iter()));
    assert!(tables.tools().tools.iter().all(|tool| tool.id != id));
}
