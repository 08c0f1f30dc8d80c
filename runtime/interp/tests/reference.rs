//! The reference pages that are checked in are those of the tables.

use std::path::Path;

use tandem_interp::{dialects, reference};

#[test]
fn the_reference_that_is_checked_in_is_that_of_the_tables() -> std::io::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/reference");
    let update = std::env::var_os("UPDATE_REFERENCE").is_some();
    for page in reference::pages(dialects::nj()) {
        let path = folder.join(page.name);
        if update {
            std::fs::write(&path, &page.text)?;
        }
        let stored = std::fs::read_to_string(&path)?;
        assert!(
            stored == page.text,
            "{} is not up to date: UPDATE_REFERENCE=1 cargo test -p tandem-interp --test reference writes it anew",
            page.name
        );
    }
    Ok(())
}

#[test]
fn the_pages_name_each_code() {
    let pages = reference::pages(dialects::nj());
    let codes = &pages[0].text;
    for code in ["G00", "G50.1", "G84", "G501", "M30", "M98"] {
        assert!(codes.contains(&format!("### {code}: ")), "{code}");
    }
}
