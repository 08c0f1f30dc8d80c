//! Programs that must not compile; the `.stderr` files next to these programs contain the expected messages
//! of the compiler. Runs only with `TANDEM_LONG`, because the crates are built again, which takes minutes.

#[test]
fn what_is_no_handler_does_not_compile_and_the_error_is_a_sentence() {
    if std::env::var_os("TANDEM_LONG").is_none() {
        return;
    }
    let cases = trybuild::TestCases::new();
    cases.pass("tests/compile/accepted/*.rs");
    cases.compile_fail("tests/compile/refused/*.rs");
}
