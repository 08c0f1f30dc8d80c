//! A wire between two programs that can be cut without a notification to either.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

use super::wait::within;

/// Answer of a broker of MQTT 3.1.1 to a client that uses 5 (MQTT-3.1.2-2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The broker answers that it does not support this version, and disconnects.
    Answer,
    /// The broker only disconnects.
    HangUp,
}

/// Forwards connections to an address. While it is cut, data waits in it, and no client can connect.
pub struct Wire {
    address: String,
    whole: watch::Sender<bool>,
    torn: watch::Sender<u32>,
    hung_up: watch::Receiver<u32>,
    task: JoinHandle<()>,
}

impl Wire {
    pub async fn to(target: &str) -> Self {
        Self::new(target, None).await
    }

    /// Makes a broker support only MQTT 3.1.1.
    pub async fn to_version_3_1_1(target: &str, refusal: Refusal) -> Self {
        Self::new(target, Some(refusal)).await
    }

    async fn new(target: &str, refusal: Option<Refusal>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("its address").to_string();
        let (whole, hanging_up) = (watch::Sender::new(true), watch::Sender::new(0));
        let torn = watch::Sender::new(0);
        let hung_up = hanging_up.subscribe();
        let (target, watching) = (target.to_owned(), whole.subscribe());
        let tearing = torn.clone();
        let task = tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                let carried = carry(
                    near,
                    target.clone(),
                    watching.clone(),
                    refusal,
                    hanging_up.clone(),
                );
                let mut torn = tearing.subscribe();
                tokio::spawn(async move {
                    tokio::select! {
                        () = carried => {}
                        _ = torn.changed() => {}
                    }
                });
            }
        });
        Self {
            address,
            whole,
            torn,
            hung_up,
            task,
        }
    }

    /// `127.0.0.1:port`
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Waits until a connection has been closed because the other end does not exist.
    pub async fn hangs_up(&mut self) {
        within("a connection that is hung up on", self.hung_up.changed())
            .await
            .expect("the wire is there");
    }

    pub fn cut(&self) {
        self.whole.send_replace(false);
    }

    /// Ends the connections, so that both sides are notified, and no client can connect until [`Wire::mend`].
    pub fn tear(&self) {
        self.cut();
        self.torn.send_modify(|count| *count += 1);
    }

    pub fn mend(&self) {
        self.whole.send_replace(true);
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn carry(
    mut near: TcpStream,
    target: String,
    mut whole: watch::Receiver<bool>,
    refusal: Option<Refusal>,
    hung_up: watch::Sender<u32>,
) {
    if !*whole.borrow() {
        // a connection would have failed: it ends unused, when the other side can be notified
        let _ = whole.wait_for(|whole| *whole).await;
        return;
    }
    let Ok(far) = TcpStream::connect(&target).await else {
        drop(near);
        hung_up.send_modify(|count| *count += 1);
        return;
    };
    if let Some(refusal) = refusal
        && speaks_5(&near).await
    {
        if refusal == Refusal::Answer {
            // CONNACK, return code 1: unacceptable protocol version
            let _ = near.write_all(&[0x20, 2, 0, 1]).await;
        }
        return;
    }
    // otherwise the system may delay small packets
    let _ = (near.set_nodelay(true), far.set_nodelay(true));
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::join!(
        forward(near_in, far_out, whole.clone()),
        forward(far_in, near_out, whole)
    );
}

/// Reads the protocol level in a CONNECT packet, which follows the name `MQTT`.
async fn speaks_5(near: &TcpStream) -> bool {
    let mut bytes = [0; 16];
    loop {
        let count = near.peek(&mut bytes).await.unwrap_or(0);
        let name = bytes[..count].windows(4).position(|name| name == b"MQTT");
        if let Some(level) = name.and_then(|name| bytes[..count].get(name + 4)) {
            return *level == 5;
        }
        if count == 0 {
            return false;
        }
        tokio::task::yield_now().await;
    }
}

async fn forward(mut from: OwnedReadHalf, mut to: OwnedWriteHalf, mut whole: watch::Receiver<bool>) {
    let mut bytes = [0; 4096];
    while let Ok(count) = from.read(&mut bytes).await {
        let mended = whole.wait_for(|whole| *whole).await.is_ok();
        if !mended || count == 0 || to.write_all(&bytes[..count]).await.is_err() {
            return;
        }
    }
}
