//! What does not compile, and in which words: the texts beside the files are what the compiler says.
//! With `TANDEM_LONG` only: the crates are built once more for it, which takes minutes.

#[test]
fn what_is_no_handler_does_not_compile_and_the_error_is_a_sentence() {
    if std::env::var_os("TANDEM_LONG").is_none() {
        return;
    }
    let cases = trybuild::TestCases::new();
    cases.pass("tests/compile/accepted/*.rs");
    cases.compile_fail("tests/compile/refused/*.rs");
}
