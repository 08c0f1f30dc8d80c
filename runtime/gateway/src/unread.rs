//! Responses that clients have not read yet: their number or their bytes are limited, in total and for each user or
//! host.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::body::{Body, Bytes, HttpBody, to_bytes};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use parking_lot::Mutex;
use plc_protocol::wire::right::Right;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use crate::access::User;
use crate::problem::Problem;

/// Largest number of concurrent requests with a whole program, in the request or in the answer; more wait. Reason: each
/// may hold 64 MiB.
const LARGE_REQUESTS_MAX: usize = 4;

/// Largest number of such requests of one user, so that other users find a permit.
const USER_LARGE_REQUESTS_MAX: usize = 2;

/// Largest number of such requests of all users who may not operate the machine.
const UNRESERVED_LARGE_REQUESTS_MAX: usize = 3;

/// Longest time that such a request waits for a permit; then 503.
const LARGE_WAIT_MAX: Duration = Duration::from_secs(30);

/// Largest size of a response that is not counted, bytes. Reason: a connection reads as many at once.
const SMALL_BYTES_MAX: usize = 64 * 1024;

/// Largest number of unread bytes of larger responses without a whole program; a response beyond them is 503.
const UNREAD_BYTES_MAX: usize = 64 * 1024 * 1024;

/// Largest number of unread bytes of one host, so that there is room for responses to other hosts.
const HOST_UNREAD_BYTES_MAX: usize = 48 * 1024 * 1024;

/// Permits of requests with a whole program.
#[derive(Debug)]
pub(crate) struct LargeRequests {
    all: Arc<Semaphore>,
    /// Of users who may not operate the machine.
    unreserved: Arc<Semaphore>,
    of_user: Mutex<HashMap<String, Weak<Semaphore>>>,
}

/// The permit of one request. Its response keeps it until it is read.
#[derive(Debug)]
pub(crate) struct LargePermit {
    _of_all: OwnedSemaphorePermit,
    _of_user: Option<OwnedSemaphorePermit>,
    _unreserved: Option<OwnedSemaphorePermit>,
}

impl LargeRequests {
    pub(crate) fn new() -> Self {
        Self {
            all: Arc::new(Semaphore::new(LARGE_REQUESTS_MAX)),
            unreserved: Arc::new(Semaphore::new(UNRESERVED_LARGE_REQUESTS_MAX)),
            of_user: Mutex::default(),
        }
    }

    /// Waits for a permit. Without a user there is no limit for one user.
    pub(crate) async fn acquire(&self, user: &User) -> Result<LargePermit, Problem> {
        let acquiring = async {
            let of_user = match user.name().map(|name| self.user_permits(name)) {
                Some(own) => Some(own.acquire_owned().await.ok()?),
                None => None,
            };
            let unreserved = if user.has(Right::Operate) {
                None
            } else {
                Some(Arc::clone(&self.unreserved).acquire_owned().await.ok()?)
            };
            Some(LargePermit {
                _of_all: Arc::clone(&self.all).acquire_owned().await.ok()?,
                _of_user: of_user,
                _unreserved: unreserved,
            })
        };
        timeout(LARGE_WAIT_MAX, acquiring)
            .await
            .ok()
            .flatten()
            .ok_or_else(|| {
                let text = format!(
                    "the limit of {LARGE_REQUESTS_MAX} programs in transit ({USER_LARGE_REQUESTS_MAX} of one \
                 user) is \
                 reached; send the request again"
                );
                Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text)
            })
    }

    fn user_permits(&self, user: &str) -> Arc<Semaphore> {
        let mut of_user = self.of_user.lock();
        of_user.retain(|_, own| own.strong_count() > 0);
        if let Some(own) = of_user.get(user).and_then(Weak::upgrade) {
            return own;
        }
        let own = Arc::new(Semaphore::new(USER_LARGE_REQUESTS_MAX));
        of_user.insert(user.to_owned(), Arc::downgrade(&own));
        own
    }
}

/// Bytes of large answers that clients have not read.
#[derive(Debug, Default)]
pub(crate) struct UnreadAnswers(Arc<Mutex<UnreadBytes>>);

#[derive(Debug, Default)]
struct UnreadBytes {
    all: usize,
    of_host: HashMap<Option<IpAddr>, usize>,
}

/// Reserved bytes of one response that the client has not read; dropping the value releases them.
#[derive(Debug)]
struct UnreadAnswer {
    table: Arc<Mutex<UnreadBytes>>,
    host: Option<IpAddr>,
    bytes: usize,
}

impl Drop for UnreadAnswer {
    fn drop(&mut self) {
        let mut table = self.table.lock();
        table.all -= self.bytes;
        if let Some(of_host) = table.of_host.get_mut(&self.host) {
            *of_host -= self.bytes;
            if *of_host == 0 {
                table.of_host.remove(&self.host);
            }
        }
    }
}

/// The body of a response, with the value that is released once the connection has read it.
struct GuardedBody<T> {
    body: Bytes,
    _until_read: T,
}

impl<T> AsRef<[u8]> for GuardedBody<T> {
    fn as_ref(&self) -> &[u8] {
        &self.body
    }
}

impl UnreadAnswers {
    /// Counts a response until the client's connection has read it. Returns 503 instead if there is no room.
    pub(crate) async fn count(&self, host: Option<IpAddr>, mut response: Response) -> Response {
        let permit = response.extensions_mut().remove::<Arc<LargePermit>>();
        // a body without an exact size is produced as the connection reads it
        let size = response.body().size_hint().exact();
        let Some(bytes) = size.and_then(|size| usize::try_from(size).ok()) else {
            return response;
        };
        if bytes <= SMALL_BYTES_MAX {
            return response;
        }
        if let Some(permit) = permit {
            return guard_body(response, permit).await;
        }
        if let Some(answer) = self.reserve(host, bytes) {
            return guard_body(response, answer).await;
        }
        let text = "unread answers fill the available memory; read them, or send the request again later";
        Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", text).into_response()
    }

    fn reserve(&self, host: Option<IpAddr>, bytes: usize) -> Option<UnreadAnswer> {
        let mut table = self.0.lock();
        let of_host = table.of_host.get(&host).copied().unwrap_or(0) + bytes;
        let has_room = table.all + bytes <= UNREAD_BYTES_MAX && of_host <= HOST_UNREAD_BYTES_MAX;
        if !has_room {
            return None;
        }
        table.all += bytes;
        table.of_host.insert(host, of_host);
        drop(table);
        Some(UnreadAnswer {
            table: Arc::clone(&self.0),
            host,
            bytes,
        })
    }
}

/// Returns the same response, whose bytes keep a value until they are written.
async fn guard_body<T: Send + 'static>(response: Response, until_read: T) -> Response {
    let (head, body) = response.into_parts();
    // a body with an exact size is in memory already
    let Ok(body) = to_bytes(body, usize::MAX).await else {
        return Problem::from(plc_protocol::wire::problem::Problem::unexpected()).into_response();
    };
    let held = GuardedBody {
        body,
        _until_read: until_read,
    };
    Response::from_parts(head, Body::from(Bytes::from_owner(held)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Role;
    use crate::access::Token;

    const BYTES: usize = 16 * 1024 * 1024;

    fn host(last: u8) -> IpAddr {
        [10, 0, 0, last].into()
    }

    async fn answer(answers: &UnreadAnswers, last: u8, bytes: usize) -> Response {
        answers
            .count(Some(host(last)), vec![b'x'; bytes].into_response())
            .await
    }

    #[tokio::test]
    async fn unread_answers_have_a_limit_for_each_host_and_in_total() {
        let answers = UnreadAnswers::default();
        let mut unread = Vec::new();
        for _ in 0..HOST_UNREAD_BYTES_MAX / BYTES {
            unread.push(answer(&answers, 1, BYTES).await);
        }
        assert!(unread.iter().all(|answer| answer.status() == 200));
        assert_eq!(answer(&answers, 1, BYTES).await.status(), 503, "of one host");
        assert_eq!(
            answer(&answers, 1, SMALL_BYTES_MAX).await.status(),
            200,
            "a small one"
        );
        unread.push(answer(&answers, 2, BYTES).await);
        assert_eq!(
            answer(&answers, 3, SMALL_BYTES_MAX + 1).await.status(),
            503,
            "in total"
        );
        let read = to_bytes(unread.remove(0).into_body(), usize::MAX).await.unwrap();
        assert_eq!(read.len(), BYTES);
        assert_eq!(
            answer(&answers, 3, BYTES).await.status(),
            503,
            "it is not written yet"
        );
        drop(read);
        assert_eq!(answer(&answers, 3, BYTES).await.status(), 200);
        drop(unread);
        let table = answers.0.lock();
        assert_eq!((table.all, table.of_host.len()), (0, 0));
    }

    #[tokio::test(start_paused = true)]
    async fn one_user_leaves_permits_of_large_requests_to_others() {
        let requests = LargeRequests::new();
        let [viewer, other] = ["viewer", "other"].map(|name| Token::user_for_test(name, Role::View));
        let admin = Token::user_for_test("admin", Role::Admin);
        let mut permits = Vec::new();
        for _ in 0..USER_LARGE_REQUESTS_MAX {
            permits.push(requests.acquire(&viewer).await.unwrap());
        }
        assert!(requests.acquire(&viewer).await.is_err());
        // viewers leave the last permit to users who may operate
        let of_other = requests.acquire(&other).await.unwrap();
        assert!(requests.acquire(&other).await.is_err());
        drop(of_other);
        permits.push(requests.acquire(&admin).await.unwrap());
        permits.push(requests.acquire(&admin).await.unwrap());
        assert!(requests.acquire(&User::Anyone).await.is_err(), "all are taken");
        assert!(requests.acquire(&admin).await.is_err(), "all are taken");
        // a response with a whole program holds its permit until it is written
        let mut response = vec![b'x'; BYTES].into_response();
        response.extensions_mut().insert(Arc::new(permits.remove(0)));
        let unread = UnreadAnswers::default().count(Some(host(1)), response).await;
        assert!(requests.acquire(&viewer).await.is_err());
        drop(unread);
        assert!(requests.acquire(&viewer).await.is_ok());
    }
}
