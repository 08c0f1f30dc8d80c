//! A wire between two programs that can be cut without either of them being told.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Carries connections to an address. While it is cut, what is sent waits in it, and nobody can connect.
pub struct Wire {
    address: String,
    whole: watch::Sender<bool>,
    task: JoinHandle<()>,
}

impl Wire {
    pub async fn to(target: &str) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("its address").to_string();
        let whole = watch::Sender::new(true);
        let (target, watching) = (target.to_owned(), whole.subscribe());
        let task = tokio::spawn(async move {
            while let Ok((near, _)) = listener.accept().await {
                tokio::spawn(carry(near, target.clone(), watching.clone()));
            }
        });
        Self { address, whole, task }
    }

    /// `127.0.0.1:port`
    pub fn address(&self) -> &str {
        &self.address
    }

    pub fn cut(&self) {
        self.whole.send_replace(false);
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

async fn carry(near: TcpStream, target: String, mut whole: watch::Receiver<bool>) {
    if !*whole.borrow() {
        // a connection would not have come about: it ends, unused, once the other side can be told
        let _ = whole.wait_for(|whole| *whole).await;
        return;
    }
    let Ok(far) = TcpStream::connect(&target).await else {
        return;
    };
    // the system may hold small packets back otherwise
    let _ = (near.set_nodelay(true), far.set_nodelay(true));
    let ((near_in, near_out), (far_in, far_out)) = (near.into_split(), far.into_split());
    tokio::join!(
        forward(near_in, far_out, whole.clone()),
        forward(far_in, near_out, whole)
    );
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
