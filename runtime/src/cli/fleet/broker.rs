//! Checks that the broker of a fleet accepts connections, before machines are started.

use std::io::ErrorKind;
use std::time::Duration;

use anyhow::bail;
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep, timeout_at};

/// Time for which a refused connection is tried again, because the broker may be starting.
const REFUSED_MAX: Duration = Duration::from_secs(5);

/// Time from one round of attempts to the next.
const RETRY_AFTER: Duration = Duration::from_millis(200);

/// Result of one attempt to connect to a node.
enum Attempt {
    Accepted,
    /// The node refused the connection, or its name is unknown: a reason for people.
    Refused(String),
    /// Any other result, such as no answer. Machines may connect later.
    Open,
}

/// Waits until a node of the broker (host and port) accepts a connection. Other nodes are not tried then.
///
/// # Errors
/// Fails if all nodes refuse connections, or have unknown names, for 5 s.
pub(super) async fn await_broker(address: &str, nodes: &[(String, u16)]) -> anyhow::Result<()> {
    await_broker_for(REFUSED_MAX, address, nodes).await
}

async fn await_broker_for(limit: Duration, address: &str, nodes: &[(String, u16)]) -> anyhow::Result<()> {
    let end = Instant::now() + limit;
    loop {
        let mut reasons = Vec::new();
        for (host, port) in nodes {
            match connect(host, *port, end).await {
                Attempt::Accepted | Attempt::Open => return Ok(()),
                Attempt::Refused(reason) => reasons.push(reason),
            }
        }
        if Instant::now() + RETRY_AFTER >= end {
            bail!(
                "the broker {address} accepted no connection for {} s ({}): start the broker, or name another one \
                 with --broker",
                limit.as_secs(),
                reasons.join("; ")
            );
        }
        sleep(RETRY_AFTER).await;
    }
}

async fn connect(host: &str, port: u16, end: Instant) -> Attempt {
    let found = timeout_at(end, tokio::net::lookup_host((host, port))).await;
    let addresses: Vec<_> = match found {
        Ok(Ok(addresses)) => addresses.collect(),
        Ok(Err(error)) => return Attempt::Refused(format!("the name {host} is unknown: {error}")),
        Err(_) => return Attempt::Refused(format!("no name server knows {host}")),
    };
    match timeout_at(end, TcpStream::connect(&addresses[..])).await {
        Ok(Ok(_)) => Attempt::Accepted,
        Ok(Err(error)) if error.kind() == ErrorKind::ConnectionRefused => {
            Attempt::Refused(format!("{host}:{port} refused the connection"))
        }
        Ok(Err(_)) | Err(_) => Attempt::Open,
    }
}

#[cfg(test)]
mod tests {
    use tokio::net::TcpSocket;

    use super::*;

    /// A port that refuses connections until the socket listens; no other program can take the port.
    fn refusing() -> (TcpSocket, u16) {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind("127.0.0.1:0".parse().unwrap()).unwrap();
        let port = socket.local_addr().unwrap().port();
        (socket, port)
    }

    #[tokio::test]
    async fn a_refused_connection_is_reported_with_address_and_remedy() {
        let (_socket, port) = refusing();
        let nodes = [("127.0.0.1".to_owned(), port)];
        let limit = Duration::from_secs(1);
        let error = await_broker_for(limit, "mqtt://broker", &nodes).await;
        let text = error.unwrap_err().to_string();
        for part in ["mqtt://broker", "refused the connection", "--broker"] {
            assert!(text.contains(part), "{text}");
        }
    }

    #[tokio::test]
    async fn one_node_that_accepts_connections_suffices() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let listens = listener.local_addr().unwrap().port();
        let (_socket, refuses) = refusing();
        let nodes = [refuses, listens].map(|port| ("127.0.0.1".to_owned(), port));
        await_broker("mqtt://broker", &nodes).await.unwrap();
    }

    #[tokio::test]
    async fn a_broker_that_starts_within_the_limit_is_accepted() {
        let (socket, port) = refusing();
        let broker = async {
            sleep(3 * RETRY_AFTER).await;
            let listener = socket.listen(1).unwrap();
            listener.accept().await.unwrap();
        };
        let nodes = [("127.0.0.1".to_owned(), port)];
        let (waited, ()) = tokio::join!(await_broker("mqtt://broker", &nodes), broker);
        waited.unwrap();
    }
}
