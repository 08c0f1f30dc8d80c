//! A stop is accepted in time while viewers let the runtime check large texts and send large documents. With `TANDEM_LONG` 500
//! stops within 250 ms each.

#![allow(clippy::print_stdout, reason = "it reports what was measured")]

use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use serde_json::json;
use tokio::task::JoinSet;

use super::urgent::machine;
use crate::support::http::{request_as, try_request_with};
use crate::support::served::Served;

/// Longest time until a stop is accepted.
const STOP_MAX: Duration = Duration::from_millis(250);

/// Longest time next to other tests, which share the processors: it shows that a stop does not wait for the
/// end of a check.
const STOP_AMONG_OTHERS_MAX: Duration = Duration::from_secs(5);

/// Lines of a text that viewers let the runtime check: a few megabytes.
const LINES: usize = 200_000;

/// Number of concurrent viewers that repeat their requests without end.
const REQUESTS: [(&str, &str); 9] = [
    ("POST", "/programs/70/check_text"),
    ("POST", "/programs/71/check_text"),
    ("POST", "/cs/1/mdi/rehearsal"),
    ("POST", "/cs/1/mdi/path"),
    ("GET", "/programs/60"),
    ("GET", "/programs/60/intermediate"),
    ("GET", "/programs/60/rehearsal"),
    ("GET", "/journal?count=1000"),
    ("GET", "/cs/1/trace"),
];

fn large_text() -> String {
    let mut text = String::from("G90 G01 X0 F6000\n");
    for line in 0..LINES {
        let _ = writeln!(text, "X{} Y{}", line % 100, line % 70);
    }
    text + "M30\n"
}

/// Sends a request of a viewer repeatedly, and counts the answers.
async fn load(
    address: String,
    (method, path): (&str, &str),
    token: String,
    texts: [Arc<str>; 2],
    answers: Arc<AtomicUsize>,
) {
    let [large, mdi] = texts;
    let (kind, body) = match path {
        _ if method == "GET" => ("", ""),
        _ if path.contains("/mdi/") => ("application/json", &*mdi),
        _ => ("text/plain", &*large),
    };
    let path = format!("/api/v1{path}");
    let headers = format!("Authorization: Bearer {token}\r\n");
    loop {
        if try_request_with(&address, method, &path, kind, body, &headers)
            .await
            .is_some()
        {
            answers.fetch_add(1, Ordering::Relaxed);
        } else {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn stop_overtakes_checks_and_documents_of_viewers() {
    let is_long = std::env::var_os("TANDEM_LONG").is_some();
    let count = if is_long { 500 } else { 12 };
    let (machine, users) = machine();
    let served = Served::start(&machine);
    let token = |name: &str| users.iter().find(|(user, _)| *user == name).unwrap().1.clone();
    let (viewer, panel, admin) = (token("view"), token("panel"), token("admin"));
    let large: Arc<str> = large_text().into();
    let program = "/api/v1/programs/60";
    let stored = request_as(&served.http, "PUT", program, "text/plain", &large, Some(&admin));
    stored.await.expect(201);
    let lines = "G91 G01 X0.01 F6000\n".repeat(2000);
    let mdi: Arc<str> = json!({ "text": lines }).to_string().into();
    let answers: Vec<Arc<AtomicUsize>> = REQUESTS.iter().map(|_| Arc::default()).collect();
    let mut loads = JoinSet::new();
    for (request, answers) in REQUESTS.into_iter().zip(&answers) {
        let texts = [Arc::clone(&large), Arc::clone(&mdi)];
        loads.spawn(load(
            served.http.clone(),
            request,
            viewer.clone(),
            texts,
            Arc::clone(answers),
        ));
    }
    tokio::time::sleep(Duration::from_secs(1)).await;
    let mut taken = Vec::new();
    for _ in 0..count {
        let begun = Instant::now();
        let stop = request_as(&served.http, "POST", "/api/v1/cs/1/stop", "", "", Some(&panel));
        let status = stop.await.status;
        taken.push(begun.elapsed());
        assert!([200, 202].contains(&status), "{status}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert!(loads.try_join_next().is_none(), "each load goes on until now");
    loads.shutdown().await;
    taken.sort();
    let (median, largest) = (taken[count / 2], taken[count - 1]);
    let answered: Vec<usize> = answers
        .iter()
        .map(|count| count.load(Ordering::Relaxed))
        .collect();
    println!("{count} stops: median {median:?}, largest {largest:?}; answers to viewers: {answered:?}");
    let limit = if is_long { STOP_MAX } else { STOP_AMONG_OTHERS_MAX };
    assert!(largest < limit, "{largest:?}");
}
