//! What does not compile, and in which words: the texts beside the files are what the compiler says.

#[test]
fn what_is_no_handler_does_not_compile_and_the_error_is_a_sentence() {
    let cases = trybuild::TestCases::new();
    cases.pass("tests/compile/accepted/*.rs");
    cases.compile_fail("tests/compile/refused/*.rs");
}
