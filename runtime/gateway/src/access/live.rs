//! The valid tokens. Their file is read again when it changes, so tokens are added and revoked without a restart.

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use plc_protocol::supervisor::Supervisor;
use tokio::sync::{Notify, watch};
use tracing::{info, warn};

use super::Tokens;
use super::tokens::Stamp;
use crate::position::every;

/// How often the file is checked.
const LOOK_INTERVAL: Duration = Duration::from_secs(2);

/// The current tokens.
#[derive(Debug, Clone)]
pub(crate) struct LiveTokens {
    tokens: watch::Receiver<Arc<Tokens>>,
    again: Arc<Notify>,
}

impl LiveTokens {
    /// Creates tokens that follow their file while any handle exists.
    pub(crate) fn follow(tokens: Arc<Tokens>, supervisor: &Supervisor) -> Self {
        Self::follow_by(tokens, SystemTime::now, supervisor)
    }

    /// Follows the file by a given clock.
    fn follow_by(
        tokens: Arc<Tokens>,
        clock: impl Fn() -> SystemTime + Send + Sync + 'static,
        supervisor: &Supervisor,
    ) -> Self {
        let left = tokens.without_expired(clock()).map(Arc::new);
        let (sender, tokens) = watch::channel(left.unwrap_or(tokens));
        let again = Arc::new(Notify::new());
        let looking = look_again(sender, Arc::clone(&again), clock, supervisor.clone());
        tokio::spawn(supervisor.essential("reader of the token file", looking));
        Self { tokens, again }
    }

    pub(crate) fn now(&self) -> Arc<Tokens> {
        Arc::clone(&self.tokens.borrow())
    }

    /// Reads the file again now, whether it looks changed or not.
    pub(crate) fn read_again(&self) {
        self.again.notify_one();
    }

    /// Waits for a change.
    pub(crate) async fn changed(&mut self) {
        if self.tokens.changed().await.is_err() {
            // the task that reads the file has ended, so no change follows
            std::future::pending::<()>().await;
        }
    }
}

/// Checks the file periodically. An invalid file changes nothing, and is logged once.
async fn look_again(
    sender: watch::Sender<Arc<Tokens>>,
    again: Arc<Notify>,
    clock: impl Fn() -> SystemTime + Send + Sync,
    supervisor: Supervisor,
) {
    let Some((path, stamp)) = sender.borrow().file() else {
        return;
    };
    let mut seen = Some(stamp);
    let mut look = every(LOOK_INTERVAL);
    loop {
        let next_end = sender.borrow().next_end();
        let ends_in = next_end.map(|end| end.duration_since(clock()).unwrap_or_default());
        let is_asked = tokio::select! {
            () = sender.closed() => return,
            _ = look.tick() => false,
            () = tokio::time::sleep(ends_in.unwrap_or(LOOK_INTERVAL)) => false,
            () = again.notified() => true,
        };
        let stamp = tokio::fs::metadata(&path)
            .await
            .ok()
            .map(|file| Stamp::from_metadata(&file));
        if stamp == seen && !is_asked {
            let left = sender.borrow().without_expired(clock());
            if let Some(left) = left {
                info!("a token of {} has expired", path.display());
                sender.send_replace(Arc::new(left));
            }
            continue;
        }
        seen = stamp;
        let file = path.clone();
        let read = supervisor.catch_blocking("read of the token file", move || Tokens::read(&file));
        match read.await {
            Some(Ok(tokens)) => {
                seen = tokens.file().map(|(_, stamp)| stamp);
                let tokens = tokens.without_expired(clock()).unwrap_or(tokens);
                if !tokens.same_users(&sender.borrow()) {
                    info!("the token file {} was read again", path.display());
                    sender.send_replace(Arc::new(tokens));
                }
            }
            Some(Err(error)) => warn!("{error}; the previous tokens stay valid"),
            None => warn!(
                "the token file {} was not read; the previous tokens stay valid",
                path.display()
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::access::{Role, new_token};

    impl LiveTokens {
        /// Creates tokens that never change.
        pub(crate) fn fixed(tokens: Arc<Tokens>) -> Self {
            Self {
                tokens: watch::channel(tokens).1,
                again: Arc::default(),
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn changed_token_file_is_reloaded_and_an_invalid_one_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.toml");
        let (one, two) = (
            new_token("one", Role::View, None).unwrap(),
            new_token("two", Role::Admin, None).unwrap(),
        );
        let write = |text: &str, mode: u32| {
            // as an editor or a tool does: write a temporary file, then rename it
            let beside = folder.path().join("beside");
            std::fs::write(&beside, text).unwrap();
            std::fs::set_permissions(&beside, std::fs::Permissions::from_mode(mode)).unwrap();
            std::fs::rename(&beside, &path).unwrap();
        };
        write(&one.entry, 0o600);
        let mut live = LiveTokens::follow(Arc::new(Tokens::read(&path).unwrap()), &Supervisor::default());
        let knows = |live: &LiveTokens, token: &str| live.now().user_of(token.as_bytes()).is_some();
        assert!(knows(&live, &one.token) && !knows(&live, &two.token));
        // none of these may remove a token, and the last one must take effect
        write("nonsense", 0o600);
        tokio::time::sleep(LOOK_INTERVAL + Duration::from_millis(500)).await;
        write(&two.entry, 0o644);
        tokio::time::sleep(LOOK_INTERVAL + Duration::from_millis(500)).await;
        live.read_again();
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert!(knows(&live, &one.token) && !knows(&live, &two.token));
        write(&two.entry, 0o600);
        tokio::time::timeout(Duration::from_secs(20), live.changed())
            .await
            .expect("the file is read again");
        assert!(!knows(&live, &one.token) && knows(&live, &two.token));
    }

    #[tokio::test(start_paused = true)]
    async fn a_token_counts_no_more_at_the_moment_of_its_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("tokens.toml");
        let (begun, today) = (tokio::time::Instant::now(), SystemTime::now());
        let clock = move || today + begun.elapsed();
        let until = today + Duration::from_secs(7001);
        let token = new_token("lent", Role::Operate, Some(until)).unwrap();
        std::fs::write(&path, &token.entry).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        let mut live = LiveTokens::follow_by(
            Arc::new(Tokens::read(&path).unwrap()),
            clock,
            &Supervisor::default(),
        );
        assert!(live.now().user_of(token.token.as_bytes()).is_some());
        live.changed().await;
        // the file holds whole seconds
        let late = begun.elapsed().abs_diff(Duration::from_secs(7001));
        assert!(late <= Duration::from_secs(1), "{late:?}");
        assert!(live.now().user_of(token.token.as_bytes()).is_none());
    }
}
