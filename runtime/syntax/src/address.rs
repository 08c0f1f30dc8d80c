//! Addresses of words, and sets of them.

macro_rules! addresses {
    ($($name:ident $text:literal,)*) => {
        /// Address of a word: one letter, or one of the letter pairs of dialect nj.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
        #[repr(u8)]
        #[expect(missing_docs, reason = "a letter is its own name")]
        pub enum Address { $($name,)* }

        impl Address {
            /// Number of addresses.
            pub const COUNT: usize = Address::ALL.len();

            /// All addresses; the 26 letters first, in order.
            pub const ALL: &[Address] = &[$(Address::$name),*];

            /// Returns the address as the manual writes it: `X`, `ta`, `VA`.
            pub const fn text(self) -> &'static str {
                match self { $(Address::$name => $text,)* }
            }
        }
    };
}

addresses! {
    A "A", B "B", C "C", D "D", E "E", F "F", G "G", H "H", I "I", J "J", K "K", L "L", M "M", N "N", O "O", P "P",
    Q "Q", R "R", S "S", T "T", U "U", V "V", W "W", X "X", Y "Y", Z "Z",
    Ta "ta", Td "td", Ts "ts",
    Va "VA", Vb "VB", Vc "VC", Vd "VD", Ve "VE", Vf "VF", Vg "VG", Vh "VH",
}

impl Address {
    /// Returns the address of a letter in upper or lower case; `None` for any other character.
    #[inline]
    pub(crate) fn from_letter(letter: u8) -> Option<Self> {
        let index = letter.to_ascii_uppercase().wrapping_sub(b'A');
        if index < 26 {
            Self::ALL.get(usize::from(index)).copied()
        } else {
            None
        }
    }

    /// Returns the address with these letters; upper and lower case are equal.
    pub fn find(letters: &str) -> Option<Self> {
        match letters.as_bytes() {
            [letter] => Self::from_letter(*letter),
            [_, _] => {
                let mut all = Self::ALL.iter().copied();
                all.find(|address| address.text().eq_ignore_ascii_case(letters))
            }
            _ => None,
        }
    }

    /// Returns the index of VA to VH among the parameters of an M code, 0 to 7; `None` for other addresses.
    pub const fn parameter_index(self) -> Option<usize> {
        let index = self as u8;
        if index >= Address::Va as u8 && index <= Address::Vh as u8 {
            Some((index - Address::Va as u8) as usize)
        } else {
            None
        }
    }
}

/// A set of addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct AddressSet(u64);

impl AddressSet {
    /// The empty set.
    pub const EMPTY: AddressSet = AddressSet(0);

    /// Returns the set of these addresses.
    pub const fn from_addresses(addresses: &[Address]) -> AddressSet {
        let mut bits = 0;
        let mut i = 0;
        while i < addresses.len() {
            bits |= 1 << addresses[i] as u8;
            i += 1;
        }
        AddressSet(bits)
    }

    /// Adds an address.
    pub const fn insert(&mut self, address: Address) {
        self.0 |= 1 << address as u8;
    }

    /// Returns true if the address is in the set.
    pub const fn contains(self, address: Address) -> bool {
        self.0 & (1 << address as u8) != 0
    }

    /// Returns true if the set contains no address.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Returns the addresses that are in at least one of the two sets.
    #[must_use]
    pub const fn union(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 | other.0)
    }

    /// Returns the addresses that are in both sets.
    #[must_use]
    pub const fn intersection(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 & other.0)
    }

    /// Returns the addresses of this set that are not in `other`.
    #[must_use]
    pub const fn without(self, other: AddressSet) -> AddressSet {
        AddressSet(self.0 & !other.0)
    }

    /// Returns the addresses of the set, ascending.
    pub fn iter(self) -> impl Iterator<Item = Address> {
        let mut bits = self.0;
        std::iter::from_fn(move || {
            let lowest = bits.trailing_zeros() as usize;
            bits &= bits.wrapping_sub(1);
            Address::ALL.get(lowest).copied()
        })
    }
}
