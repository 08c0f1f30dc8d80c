//! Slots of one kind that accounts share, such as those of open `WebSocket` connections.
//!
//! A user's share keeps that user from taking all slots. Some slots are reserved for users who may operate the machine
//! or serve M codes. Without users, every client on the computer has all rights, and only the total is limited.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::wire::right::Right;

use crate::access::{Account, User};

/// Limits of slots of one kind.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AccountLimits {
    /// All slots.
    pub(crate) all: usize,
    /// Slots of one user.
    pub(crate) of_user: usize,
    /// Slots of all users who neither operate the machine nor serve M codes.
    pub(crate) unreserved: usize,
}

/// Slots, by account.
#[derive(Debug)]
pub(crate) struct AccountSlots {
    limits: AccountLimits,
    table: Arc<Mutex<AccountTable>>,
}

#[derive(Debug, Default)]
struct AccountTable {
    all: usize,
    unreserved: usize,
    of_account: HashMap<Account, usize>,
    /// Slots with a name, such as the id of a command.
    named: HashSet<(Account, String)>,
}

/// A slot; it becomes free when this is dropped.
#[derive(Debug)]
pub(crate) struct AccountSlot {
    table: Arc<Mutex<AccountTable>>,
    account: Account,
    is_reserved: bool,
    name: Option<String>,
}

/// Result of a request for a named slot.
#[derive(Debug)]
pub(crate) enum NamedSlot {
    New(AccountSlot),
    /// The account holds a slot of this name.
    Held,
    /// No slot is free.
    Full,
}

/// Returns true for a user for whom slots are reserved.
fn is_reserved(user: &User) -> bool {
    user.has(Right::Operate) || user.has(Right::Handle)
}

impl AccountSlots {
    pub(crate) fn new(limits: AccountLimits) -> Self {
        Self {
            limits,
            table: Arc::default(),
        }
    }

    /// Takes a slot. Returns `None` if none is free for this account.
    pub(crate) fn acquire(&self, user: &User, account: Account) -> Option<AccountSlot> {
        self.take_slot(&mut self.table.lock(), user, account, None)
    }

    /// Takes a slot of this name, unless the account already holds it.
    pub(crate) fn acquire_named(&self, user: &User, account: Account, name: String) -> NamedSlot {
        let mut table = self.table.lock();
        if table.named.contains(&(account.clone(), name.clone())) {
            return NamedSlot::Held;
        }
        match self.take_slot(&mut table, user, account, Some(name)) {
            Some(slot) => NamedSlot::New(slot),
            None => NamedSlot::Full,
        }
    }

    fn take_slot(
        &self,
        table: &mut AccountTable,
        user: &User,
        account: Account,
        name: Option<String>,
    ) -> Option<AccountSlot> {
        let AccountLimits {
            all,
            of_user,
            unreserved,
        } = self.limits;
        let is_reserved = is_reserved(user);
        let own = table.of_account.get(&account).copied().unwrap_or(0);
        let is_full = table.all >= all
            || matches!(account, Account::User(_)) && own >= of_user
            || !is_reserved && table.unreserved >= unreserved;
        if is_full {
            return None;
        }
        table.all += 1;
        table.unreserved += usize::from(!is_reserved);
        table.of_account.insert(account.clone(), own + 1);
        if let Some(name) = &name {
            table.named.insert((account.clone(), name.clone()));
        }
        Some(AccountSlot {
            table: Arc::clone(&self.table),
            account,
            is_reserved,
            name,
        })
    }
}

impl Drop for AccountSlot {
    fn drop(&mut self) {
        let mut table = self.table.lock();
        table.all -= 1;
        table.unreserved -= usize::from(!self.is_reserved);
        if let Some(own) = table.of_account.get_mut(&self.account) {
            *own -= 1;
            if *own == 0 {
                table.of_account.remove(&self.account);
            }
        }
        if let Some(name) = self.name.take() {
            table.named.remove(&(self.account.clone(), name));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;
    use crate::access::Token;

    const LIMITS: AccountLimits = AccountLimits {
        all: 8,
        of_user: 4,
        unreserved: 6,
    };

    fn acquire_all(slots: &AccountSlots, user: &User) -> Vec<AccountSlot> {
        let account = || Account::new(user, None);
        std::iter::from_fn(|| slots.acquire(user, account())).collect()
    }

    #[test]
    fn one_user_and_all_viewers_leave_slots_to_those_who_operate() {
        let slots = AccountSlots::new(LIMITS);
        let view = |name: &str| Token::user_for_test(name, Role::View);
        let held = [view("a"), view("b"), view("c")].map(|user| acquire_all(&slots, &user));
        assert_eq!(held.each_ref().map(Vec::len), [4, 2, 0]);
        let operate = Token::user_for_test("operate", Role::Operate);
        let own = acquire_all(&slots, &operate);
        assert_eq!(own.len(), 2);
        drop(held);
        assert_eq!(acquire_all(&slots, &operate).len(), 2, "4 with the others");
        drop(own);
        assert_eq!(acquire_all(&slots, &User::Anyone).len(), 8, "without users");
        assert_eq!(acquire_all(&slots, &view("a")).len(), 4, "all are free again");
    }

    #[test]
    fn a_name_takes_one_slot_of_its_account() {
        let slots = AccountSlots::new(LIMITS);
        let [anna, bert] = ["anna", "bert"].map(|name| Token::user_for_test(name, Role::Operate));
        let named = |user: &User| slots.acquire_named(user, Account::new(user, None), "run-1".to_owned());
        let NamedSlot::New(first) = named(&anna) else {
            panic!("it is free");
        };
        assert!(matches!(named(&anna), NamedSlot::Held));
        assert!(
            matches!(named(&bert), NamedSlot::New(_)),
            "the same name of another user"
        );
        drop(first);
        let again = named(&anna);
        assert!(matches!(again, NamedSlot::New(_)));
        let rest = acquire_all(&slots, &anna);
        assert_eq!(rest.len(), LIMITS.of_user - 1);
        let other = slots.acquire_named(&anna, Account::new(&anna, None), "run-2".to_owned());
        assert!(matches!(other, NamedSlot::Full));
    }
}
