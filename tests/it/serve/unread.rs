//! Peers that send without end and never read: the memory for their answers stays within a limit, and the
//! runtime accepts a stop.

#![allow(clippy::print_stdout, reason = "measurements are printed")]
#![allow(
    clippy::cast_possible_truncation,
    reason = "lengths of packets that are made here"
)]

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::json;

use super::access::{post, token};
use super::reach::allocated_mib;
use crate::support::machine::Machine;
use crate::support::served::{FREE_PORTS, Served};

/// Peers that attack at the same time.
const PEERS: usize = 4;

/// Time for which they attack.
const ATTACK: Duration = Duration::from_secs(3);

/// A peer is stopped if no byte of it is read for this time.
const STOPPED_AFTER: Duration = Duration::from_millis(700);

/// Growth of the memory during one attack. Reason: for each peer the largest message, data in transit, and the buffers
/// of its connection.
const GROWTH_MAX_MIB: u64 = 8;

/// Bytes of one write of a peer.
const WRITE_BYTES: usize = 64 * 1024;

struct Attacked {
    machine: Machine,
    served: Served,
    viewer: String,
    operator: String,
}

impl Attacked {
    fn start() -> Self {
        let users = FREE_PORTS
            .replace("[http]\n", "[http]\ntoken_file = \"tokens.toml\"\n")
            .replace("[mqtt]\n", "[mqtt]\nwebsocket = true\n");
        let machine = Machine::new(&users);
        let viewer = token(&machine, "viewer", "view");
        let operator = token(&machine, "operator", "operate");
        let served = Served::start(&machine);
        Self {
            machine,
            served,
            viewer,
            operator,
        }
    }

    fn tcp(address: &str) -> TcpStream {
        let stream = TcpStream::connect(address).expect("a connection");
        let limit = Some(Duration::from_secs(10));
        stream.set_read_timeout(limit).expect("a time limit");
        stream
    }

    /// An open WebSocket.
    fn websocket(&self, path: &str, protocol: &str) -> TcpStream {
        let mut stream = Self::tcp(&self.served.http);
        let upgrade = format!(
            "GET {path} HTTP/1.1\r\nHost: {}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
             Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\
             Sec-WebSocket-Protocol: {protocol}\r\n\r\n",
            self.served.http
        );
        stream.write_all(upgrade.as_bytes()).expect("it is read");
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).expect("an answer");
            head.push(byte[0]);
        }
        let head = String::from_utf8_lossy(&head).into_owned();
        assert!(head.starts_with("HTTP/1.1 101"), "{head}");
        stream
    }

    /// A WebSocket of the viewer.
    fn own_websocket(&self) -> TcpStream {
        self.websocket("/api/v1/ws", &format!("tandem.v1, bearer.{}", self.viewer))
    }

    /// A CONNECT packet of MQTT 3.1.1.
    fn connect(user: &str, password: &str, id: &str) -> Vec<u8> {
        let text = |text: &str| [&(text.len() as u16).to_be_bytes(), text.as_bytes()].concat();
        let body = [
            text("MQTT"),
            vec![4, 0xc2, 0, 60],
            text(id),
            text(user),
            text(password),
        ];
        packet(0x10, &body.concat())
    }

    /// A connection of a user to the broker over TCP.
    fn mqtt(&self, user: &str, peer: usize) -> TcpStream {
        let password = if user == "viewer" {
            &self.viewer
        } else {
            &self.operator
        };
        let mut stream = Self::tcp(&self.served.broker);
        let connect = Self::connect(user, password, &format!("peer-{peer}"));
        stream.write_all(&connect).expect("it is read");
        let mut answer = [0; 4];
        stream.read_exact(&mut answer).expect("an answer");
        assert_eq!(answer, [0x20, 2, 0, 0]);
        stream
    }

    /// A connection of the viewer to the broker over a WebSocket.
    fn mqtt_websocket(&self, peer: usize) -> TcpStream {
        let mut stream = self.websocket("/mqtt", "mqtt");
        let connect = Self::connect("viewer", &self.viewer, &format!("page-{peer}"));
        stream.write_all(&frame(0x82, &connect)).expect("it is read");
        let mut answer = [0; 6];
        stream.read_exact(&mut answer).expect("an answer");
        assert_eq!(answer, [0x82, 4, 0x20, 2, 0, 0]);
        stream
    }

    /// Has peers send the same bytes again and again without reading. Returns the growth of the memory and the number of
    /// bytes that the runtime took, both in MiB.
    async fn attack(&self, open: impl Fn(usize) -> TcpStream, bytes: &[u8]) -> (u64, u64) {
        let process = self.served.process.id();
        let before = allocated_mib(process);
        let many = bytes.repeat((WRITE_BYTES / bytes.len()).max(1));
        let peers: Vec<_> = (0..PEERS)
            .map(|peer| {
                let (stream, many) = (open(peer), many.clone());
                std::thread::spawn(move || flood(stream, &many))
            })
            .collect();
        let mut most = before;
        while peers.iter().any(|peer| !peer.is_finished()) {
            tokio::time::sleep(Duration::from_millis(20)).await;
            most = most.max(allocated_mib(process));
        }
        let stopped = post(&self.served, "/cs/1/stop", Some(&self.operator), &json!({})).await;
        assert_eq!(stopped.status, 202, "{}", stopped.body);
        most = most.max(allocated_mib(process));
        let flooded: Vec<_> = peers
            .into_iter()
            .map(|peer| peer.join().expect("a peer"))
            .collect();
        let taken: u64 = flooded.iter().map(|(_, taken)| taken).sum();
        (most - before, taken >> 20)
    }
}

/// Sends without reading until the time is over, the connection ends, or further bytes are rejected. Returns
/// the connection, which stays open until then, and the number of accepted bytes.
fn flood(mut stream: TcpStream, bytes: &[u8]) -> (TcpStream, u64) {
    stream.set_nonblocking(true).expect("a socket");
    let (end, mut progress) = (Instant::now() + ATTACK, Instant::now());
    let (mut taken, mut place) = (0, 0);
    while Instant::now() < end && progress.elapsed() < STOPPED_AFTER {
        match stream.write(&bytes[place..]) {
            Ok(count) => {
                taken += count as u64;
                place = (place + count) % bytes.len();
                progress = Instant::now();
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                std::thread::sleep(Duration::from_millis(2));
            }
            Err(_) => break,
        }
    }
    (stream, taken)
}

/// A masked frame of a WebSocket, with a mask of zeros.
fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
    let length = payload.len();
    let lengths = match length {
        0..126 => vec![0x80 | length as u8],
        126..65536 => [&[0xfe][..], &(length as u16).to_be_bytes()].concat(),
        _ => [&[0xff][..], &(length as u64).to_be_bytes()].concat(),
    };
    [&[first][..], &lengths, &[0; 4], payload].concat()
}

/// An MQTT packet.
fn packet(first: u8, body: &[u8]) -> Vec<u8> {
    let (mut packet, mut length) = (vec![first], body.len());
    loop {
        let more = if length > 127 { 0x80 } else { 0 };
        packet.push((length % 128) as u8 | more);
        length /= 128;
        if length == 0 {
            return [packet, body.to_vec()].concat();
        }
    }
}

/// Frames that peers send over a WebSocket, with names.
fn frames() -> Vec<(&'static str, Vec<u8>)> {
    vec![
        ("pings of 125 bytes", frame(0x89, &[b'p'; 125])),
        ("pings without bytes", frame(0x89, b"")),
        ("pongs", frame(0x8a, &[b'p'; 125])),
        ("empty binary frames", frame(0x82, b"")),
        ("binary frames", frame(0x82, &[0; 1000])),
        ("texts that are no JSON", frame(0x81, &[b'x'; 1000])),
        ("subscriptions to all", frame(0x81, br##"{"subscribe":["#"]}"##)),
        (
            "subscriptions to nothing",
            frame(0x81, br#"{"subscribe":["cs/1/nothing"]}"#),
        ),
        (
            "empty fragments",
            [frame(0x01, b""), frame(0x00, b"").repeat(1000)].concat(),
        ),
        ("closes", frame(0x88, &[3, 232])),
    ]
}

/// Packets that peers send over MQTT, with names.
fn packets() -> Vec<(&'static str, Vec<u8>)> {
    let topic = |text: &str| [&(text.len() as u16).to_be_bytes(), text.as_bytes()].concat();
    let all = topic("#");
    let read = [
        topic("tandem/v1/test-1/cs/1/variable/get"),
        vec![0, 1],
        br#"{"kind":"P","from":0,"count":1024}"#.to_vec(),
    ];
    vec![
        ("PINGREQ", packet(0xc0, b"")),
        ("SUBSCRIBE", packet(0x82, &[&[0, 1][..], &all, &[1]].concat())),
        ("UNSUBSCRIBE", packet(0xa2, &[&[0, 1][..], &all].concat())),
        (
            "PUBLISH with quality 1",
            packet(0x32, &[topic("plant"), vec![0, 1], vec![b'x'; 500]].concat()),
        ),
        (
            "PUBLISH with quality 2",
            packet(0x34, &[topic("plant"), vec![0, 1], vec![b'x'; 500]].concat()),
        ),
        ("PUBREL", packet(0x62, &[0, 1])),
        ("questions", packet(0x32, &read.concat())),
    ]
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn peers_that_never_read_make_the_runtime_owe_a_bounded_number_of_bytes() {
    let attacked = Attacked::start();
    let mut found = Vec::new();
    let head = |path: &str, token: &str| {
        let host = &attacked.served.http;
        format!("GET {path} HTTP/1.1\r\nHost: {host}\r\n{token}\r\n").into_bytes()
    };
    let bearer = format!("Authorization: Bearer {}\r\n", attacked.viewer);
    for (name, request) in [
        ("requests without a token", head("/api/v1/health", "")),
        ("requests of the viewer", head("/api/v1/cs/1/state", &bearer)),
        ("requests for documents", head("/api/v1/openapi.json", &bearer)),
    ] {
        let open = |_| Attacked::tcp(&attacked.served.http);
        found.push((format!("HTTP, {name}"), attacked.attack(open, &request).await));
    }
    for (name, bytes) in frames() {
        let open = |_| attacked.own_websocket();
        found.push((format!("WebSocket, {name}"), attacked.attack(open, &bytes).await));
        let open = |_| attacked.websocket("/mqtt", "mqtt");
        found.push((
            format!("/mqtt without a token, {name}"),
            attacked.attack(open, &bytes).await,
        ));
        let open = |peer| attacked.mqtt_websocket(peer);
        found.push((
            format!("/mqtt of the viewer, {name}"),
            attacked.attack(open, &bytes).await,
        ));
    }
    for (name, bytes) in packets() {
        let open = |_| Attacked::tcp(&attacked.served.broker);
        found.push((
            format!("MQTT without a token, {name}"),
            attacked.attack(open, &bytes).await,
        ));
        let open = |peer| attacked.mqtt("operator", peer);
        found.push((
            format!("MQTT of an operator, {name}"),
            attacked.attack(open, &bytes).await,
        ));
    }
    let half = Attacked::connect("viewer", &"x".repeat(60_000), "half");
    let open = |_| Attacked::tcp(&attacked.served.broker);
    found.push(("MQTT without a token, a CONNECT that is too large".to_owned(), {
        let mut large = packet(0x10, &vec![0; 1_000_000]);
        large.truncate(900_000);
        attacked.attack(open, &large).await
    }));
    found.push((
        "MQTT without a token, wrong tokens".to_owned(),
        attacked.attack(open, &half).await,
    ));
    for (name, (growth, taken)) in &found {
        println!("{growth:3} MiB more, {taken:4} MiB taken: {name}");
    }
    let beyond: Vec<_> = found
        .iter()
        .filter(|(_, (growth, _))| *growth > GROWTH_MAX_MIB)
        .collect();
    assert!(beyond.is_empty(), "more than {GROWTH_MAX_MIB} MiB: {beyond:?}");
    drop(attacked.machine);
}
