//! With any content of its files, the data folder is read or refused, and returns only stored values.

mod readers;

use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn bytes_of_any_kind_in_the_data_folder_are_opened_verified_and_repaired(
        place in any::<[u8; 5]>(),
        bytes in proptest::collection::vec(any::<u8>(), 0..40),
    ) {
        readers::data_folder(&[&place[..], &bytes].concat());
    }
}
