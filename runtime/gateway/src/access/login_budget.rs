//! Limits on PIN attempts for each user and host, so that a stranger on another host cannot block a person's login.
//!
//! A host is familiar to the users who have logged in from there. Their attempts are counted for each user, so that one
//! user's attempts block no other one, and together in a total of the host.
//!
//! Known and unknown names are counted in the same way, by a keyed hash, so that no rejection reveals whether a user
//! exists.

use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::{Rate, Rates};

/// Attempts of one user from one host: a burst, and then one per interval. Reason: a person who mistypes a few times
/// does not wait, and guessing 6 digits from one host takes a year.
const PAIR_BURST: u32 = 10;
const PAIR_SECONDS: f64 = 30.0;

/// Attempts of one user from all hosts together from which that user has never logged in. Reason: ten hosts at their
/// full rate do not use it up.
const USER_BURST: u32 = 100;
const USER_SECONDS: f64 = 3.0;

/// Attempts of all users from one host, except users who have logged in from there.
const HOST_BURST: u32 = 10;
const HOST_SECONDS: f64 = 15.0;

/// Attempts of all users together from one host from which they have logged in. Reason: ten users at their full rate do
/// not use it up, so a stranger at this host who guesses the PIN of one user blocks no other one.
const FAMILIAR_HOST_BURST: u32 = 10 * PAIR_BURST;
const FAMILIAR_HOST_SECONDS: f64 = PAIR_SECONDS / 10.0;

/// Largest number of hosts remembered for one user; a further one replaces the one that was used longest ago.
const HOSTS_PER_USER_MAX: usize = 16;

/// Largest number of logins that wait for another one's check: in total, of one host, and of users from hosts from
/// which they have never logged in. Reason: a check takes 50 ms, so the last one waits 1.6 s.
const WAITING_MAX: usize = 32;
const WAITING_PER_HOST_MAX: usize = 2;
const WAITING_UNFAMILIAR_MAX: usize = 24;

/// Keyed hash of a name. The key is new at each start.
type NameHash = u64;

/// Budgets of all users and hosts.
pub(super) struct LoginBudgets {
    key: RandomState,
    of_pair: Rates<(NameHash, IpAddr)>,
    of_user: Rates<NameHash>,
    of_host: Rates<IpAddr>,
    of_familiar_host: Rates<IpAddr>,
    /// Hosts from which each user has logged in, the latest last.
    familiar: Mutex<HashMap<NameHash, Vec<IpAddr>>>,
    waiting: Arc<Semaphore>,
    unfamiliar: Arc<Semaphore>,
    waiting_hosts: Mutex<HashMap<IpAddr, Arc<Semaphore>>>,
}

impl Default for LoginBudgets {
    fn default() -> Self {
        Self {
            key: RandomState::new(),
            of_pair: Rates::new(PAIR_BURST, 1.0 / PAIR_SECONDS),
            of_user: Rates::new(USER_BURST, 1.0 / USER_SECONDS),
            of_host: Rates::new(HOST_BURST, 1.0 / HOST_SECONDS),
            of_familiar_host: Rates::new(FAMILIAR_HOST_BURST, 1.0 / FAMILIAR_HOST_SECONDS),
            familiar: Mutex::default(),
            waiting: Arc::new(Semaphore::new(WAITING_MAX)),
            unfamiliar: Arc::new(Semaphore::new(WAITING_UNFAMILIAR_MAX)),
            waiting_hosts: Mutex::default(),
        }
    }
}

/// One attempt of a login.
pub(super) struct LoginTry {
    name: NameHash,
    host: IpAddr,
    counted: Vec<Arc<Rate>>,
    is_familiar: bool,
}

/// A slot among the logins that wait for their check.
pub(super) struct WaitingSlot {
    _places: Vec<OwnedSemaphorePermit>,
}

impl LoginBudgets {
    /// Counts an attempt. The error is the time until the next one is accepted.
    pub(super) fn count(&self, name: &str, host: IpAddr) -> Result<LoginTry, Duration> {
        let name = self.key.hash_one(name);
        let is_familiar = (self.familiar.lock().get(&name)).is_some_and(|hosts| hosts.contains(&host));
        let mut rates = vec![self.of_pair.rate_for(&(name, host))];
        if is_familiar {
            rates.push(self.of_familiar_host.rate_for(&host));
        } else {
            rates.push(self.of_user.rate_for(&name));
            // programs on the same computer and persons share this host
            if !host.is_loopback() {
                rates.push(self.of_host.rate_for(&host));
            }
        }
        let mut counted: Vec<Arc<Rate>> = Vec::new();
        for rate in rates {
            if let Err(wait) = rate.try_charge() {
                for rate in &counted {
                    rate.refund();
                }
                return Err(wait);
            }
            counted.push(rate);
        }
        Ok(LoginTry {
            name,
            host,
            counted,
            is_familiar,
        })
    }

    /// Takes a slot to wait for the check; `None` if all are used.
    pub(super) fn wait(&self, of: &LoginTry) -> Option<WaitingSlot> {
        let host = {
            let mut hosts = self.waiting_hosts.lock();
            hosts.retain(|_, places| places.available_permits() < WAITING_PER_HOST_MAX);
            let new = || Arc::new(Semaphore::new(WAITING_PER_HOST_MAX));
            Arc::clone(hosts.entry(of.host).or_insert_with(new))
        };
        let mut places = vec![Arc::clone(&self.waiting).try_acquire_owned().ok()?];
        if !of.is_familiar {
            places.push(host.try_acquire_owned().ok()?);
            places.push(Arc::clone(&self.unfamiliar).try_acquire_owned().ok()?);
        }
        Some(WaitingSlot { _places: places })
    }

    /// Refunds a successful attempt, and remembers its host for the user.
    pub(super) fn succeed(&self, of: &LoginTry) {
        of.counted.iter().for_each(|rate| rate.refund());
        let mut familiar = self.familiar.lock();
        let hosts = familiar.entry(of.name).or_default();
        hosts.retain(|host| *host != of.host);
        if hosts.len() >= HOSTS_PER_USER_MAX {
            hosts.remove(0);
        }
        hosts.push(of.host);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(number: u8) -> IpAddr {
        [10, 0, 0, number].into()
    }

    #[tokio::test(start_paused = true)]
    async fn a_stranger_on_another_host_uses_up_no_budget_of_a_person() {
        let budgets = LoginBudgets::default();
        for round in 0..600 {
            for stranger in 1..=4 {
                let _ = budgets.count("anna", host(stranger));
            }
            tokio::time::advance(Duration::from_millis(250)).await;
            if round % 80 == 0 {
                assert!(budgets.count("anna", host(9)).is_ok(), "after {round} rounds");
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_familiar_host_has_its_budget_however_many_hosts_guess() {
        let budgets = LoginBudgets::default();
        let login = budgets.count("anna", host(9)).unwrap();
        budgets.succeed(&login);
        for stranger in 10..=200 {
            for _ in 0..PAIR_BURST {
                let _ = budgets.count("anna", host(stranger));
            }
        }
        assert!(
            budgets.count("anna", host(201)).is_err(),
            "all unfamiliar hosts share one"
        );
        for _ in 0..PAIR_BURST {
            assert!(budgets.count("anna", host(9)).is_ok());
        }
        assert!(budgets.count("anna", host(9)).is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn familiar_users_of_a_host_have_a_total_that_one_cannot_use_up() {
        let budgets = LoginBudgets::default();
        let names: Vec<String> = (0..20).map(|n| format!("user-{n}")).collect();
        for name in names.iter().map(String::as_str).chain(["anna"]) {
            for of in [host(9), host(8)] {
                let login = budgets.count(name, of).ok();
                if let Some(login) = login {
                    budgets.succeed(&login);
                }
            }
            tokio::time::advance(Duration::from_mins(1)).await;
        }
        let guess = |name: &str| (0..1000).filter(|_| budgets.count(name, host(9)).is_ok()).count();
        // a stranger at the same host who guesses the PIN of one person
        assert_eq!(guess("user-0"), 10);
        assert!(budgets.count("anna", host(9)).is_ok(), "another person logs in");
        let guessed: usize = names[1..].iter().map(|name| guess(name)).sum();
        assert_eq!(guessed, 89, "100 in total");
        assert!(
            budgets.count("anna", host(8)).is_ok(),
            "from another familiar host"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn unknown_and_known_names_have_budgets_that_share_nothing() {
        let budgets = LoginBudgets::default();
        for n in 0..5000 {
            let _ = budgets.count(&format!("made-up-{n}"), IpAddr::from([127, 0, 0, 1]));
        }
        let mut counted = 0;
        while budgets.count("anna", host(1)).is_ok() {
            counted += 1;
        }
        assert_eq!(counted, PAIR_BURST, "no made-up name has used up any of it");
    }

    #[tokio::test(start_paused = true)]
    async fn one_host_takes_few_places_and_familiar_users_have_their_own() {
        let budgets = LoginBudgets::default();
        let login = budgets.count("anna", host(9)).unwrap();
        budgets.succeed(&login);
        let mut places = Vec::new();
        for stranger in 20..80 {
            for name in ["a", "b", "c"] {
                let tried = budgets.count(name, host(stranger));
                places.extend(tried.ok().and_then(|tried| budgets.wait(&tried)));
            }
        }
        assert_eq!(places.len(), WAITING_UNFAMILIAR_MAX);
        let login = budgets.count("anna", host(9)).unwrap();
        assert!(budgets.wait(&login).is_some());
    }
}
