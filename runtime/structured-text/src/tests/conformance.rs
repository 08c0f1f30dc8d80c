use std::collections::HashSet;

use crate::conformance::FEATURES;

/// The tests that features name.
const SOURCES: [&str; 7] = [
    include_str!("declarations.rs"),
    include_str!("faults.rs"),
    include_str!("functions.rs"),
    include_str!("literals.rs"),
    include_str!("operators.rs"),
    include_str!("statements.rs"),
    include_str!("units.rs"),
];

#[test]
fn every_feature_has_a_test_of_its_own() {
    let mut seen = HashSet::new();
    for feature in FEATURES {
        let test = format!("#[test]\nfn {}()", feature.test);
        assert!(
            SOURCES.iter().any(|source| source.contains(&test)),
            "no test {}",
            feature.test
        );
        assert!(seen.insert(feature.test), "{} proves two features", feature.test);
    }
    assert!(FEATURES.len() > 50);
}

#[test]
fn codes_of_findings_ascend_and_have_numbers_of_their_own() {
    let codes: Vec<&str> = crate::FINDINGS.iter().map(|entry| entry.code).collect();
    assert!(codes.is_sorted_by(|one, other| one < other), "{codes:?}");
}
