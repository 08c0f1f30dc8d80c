//! Waits with a limit: a test that would hang fails instead, and names the missing condition.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use serde_json::Value;
use tokio::sync::Notify;
use tokio::time::Instant;

/// Time limit of all waits in these tests.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// Returns the result of a future; after the time limit, the test fails with the name of the missing
/// condition.
pub async fn within<T>(what: &str, future: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, future)
        .await
        .unwrap_or_else(|_| panic!("{what}: not within {} s", PATIENCE.as_secs()))
}

/// Repeats a query until it returns a value.
pub async fn until<T>(what: &str, ask: impl AsyncFnMut() -> Option<T>) -> T {
    until_within(PATIENCE, what, ask).await
}

/// Repeats a query with a longer limit.
pub async fn until_within<T>(limit: Duration, what: &str, mut ask: impl AsyncFnMut() -> Option<T>) -> T {
    let end = Instant::now() + limit;
    loop {
        let answer = tokio::time::timeout_at(end, ask()).await;
        if let Ok(Some(found)) = answer {
            return found;
        }
        assert!(Instant::now() < end, "{what}: not within {} s", limit.as_secs());
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// Recorded messages on topics, in order. A clone is another handle to the same history.
#[derive(Clone, Default)]
pub struct History {
    said: Arc<Mutex<Vec<(String, Value)>>>,
    news: Arc<Notify>,
}

impl History {
    pub fn push(&self, topic: String, value: Value) {
        self.said.lock().unwrap().push((topic, value));
        self.news.notify_waiters();
    }

    /// Returns all messages on a topic so far.
    pub fn on(&self, topic: &str) -> Vec<Value> {
        let said = self.said.lock().unwrap();
        said.iter()
            .filter(|(on, _)| on == topic)
            .map(|(_, value)| value.clone())
            .collect()
    }

    /// Returns the first matching value on a topic, from the beginning of the history on.
    pub async fn find(&self, topic: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let search = async {
            loop {
                let news = self.news.notified();
                tokio::pin!(news);
                news.as_mut().enable();
                if let Some(found) = self.on(topic).into_iter().find(&fits) {
                    return found;
                }
                news.await;
            }
        };
        let found = tokio::time::timeout(PATIENCE, search).await;
        found.unwrap_or_else(|_| panic!("nothing that fits on {topic}: {:#?}", self.on(topic)))
    }

    /// Returns the state words of a coordinate system, without successive duplicates.
    pub fn executions(&self, cs: u8) -> Vec<String> {
        let states = self.on(&format!("cs/{cs}/state"));
        let mut words: Vec<String> = states
            .iter()
            .filter_map(|state| state["execution"].as_str().map(str::to_owned))
            .collect();
        words.dedup();
        words
    }
}
