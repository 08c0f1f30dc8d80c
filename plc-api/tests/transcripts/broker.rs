//! A scripted MQTT broker with a machine: the test decides what it publishes and accepts.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;

use serde_json::{Map, Value, json};

pub const PRESENCE: &str = "handler/cell/presence";
const MACHINE: &str = "tandem/v1/mill-1/";
const CONNECT: u8 = 1;
const PUBLISH: u8 = 3;
const SUBSCRIBE: u8 = 8;
const PING: u8 = 12;
const HAS_WILL: u8 = 4;

/// Accepts connections, keeps retained messages, and answers for a machine that is online.
pub struct FakeBroker {
    table: Value,
    accepts: bool,
    address: SocketAddr,
    state: Mutex<BrokerState>,
}

#[derive(Default)]
pub struct BrokerState {
    /// Received messages: topic below the machine, payload.
    pub heard: VecDeque<(String, Value)>,
    /// Last will of the newest connection.
    pub will: Value,
    /// Instance of the handler that has published a presence.
    pub instance: Value,
    /// New connections are closed at once.
    pub is_down: bool,
    lines: Vec<TcpStream>,
    retained: BTreeMap<String, Value>,
}

impl FakeBroker {
    /// Listens. `table` is the file of the transcripts, with the members that messages of the machine have.
    pub fn open(table: Value, accepts: bool) -> Arc<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
        let broker = Arc::new(Self {
            table,
            accepts,
            address: listener.local_addr().expect("an address"),
            state: Mutex::default(),
        });
        for topic in ["birth", "presence"] {
            broker.publish(topic, &json!({}));
        }
        let served = Arc::downgrade(&broker);
        thread::spawn(move || {
            for line in listener.incoming() {
                let Some(broker) = served.upgrade() else { return };
                let line = line.expect("a connection");
                thread::spawn(move || broker.serve(&line));
            }
        });
        broker
    }

    /// Returns the address of its machine.
    pub fn address(&self) -> String {
        format!("mqtt://{}/mill-1", self.address)
    }

    pub fn state(&self) -> MutexGuard<'_, BrokerState> {
        self.state.lock().expect("no thread has panicked")
    }

    /// Publishes a message of the machine; states stay for later connections.
    pub fn publish(&self, topic: &str, members: &Value) {
        let whole = self.message(topic, members);
        let mut state = self.state();
        if ["birth", "presence"].contains(&topic) || topic.ends_with("/pending") {
            state.retained.insert(topic.to_owned(), whole.clone());
        }
        state.publish(topic, whole);
    }

    /// Returns a message of the machine with these members; the table has the other ones.
    fn message(&self, topic: &str, members: &Value) -> Value {
        let levels = topic.split('/').enumerate().map(|(at, level)| match at {
            1 | 3 if level != "pending" => "+",
            _ => level,
        });
        let defaults = &self.table["messages"];
        let pattern = levels.collect::<Vec<_>>().join("/");
        let mut whole = merged(defaults.get(topic).unwrap_or(&defaults[pattern]), members);
        if let Some(outputs) = whole["outputs"].as_array() {
            let outputs = outputs.iter().map(|output| merged(&self.table["output"], output));
            whole["outputs"] = outputs.collect();
        }
        whole
    }

    /// Breaks all connections; the broker publishes the last will.
    pub fn cut(&self) {
        let mut state = self.state();
        if !state.will.is_null() {
            let will = state.will.clone();
            state.retained.insert(PRESENCE.to_owned(), will);
        }
        for line in state.lines.drain(..) {
            let _closed_by_the_client = line.shutdown(Shutdown::Both);
        }
    }

    fn serve(&self, line: &TcpStream) {
        let is_down = self.state().is_down;
        while !is_down && self.answer(line).is_ok() {}
        let _closed_by_the_client = line.shutdown(Shutdown::Both);
    }

    /// Reads and answers one packet.
    fn answer(&self, mut line: &TcpStream) -> io::Result<()> {
        let (kind, body) = read_packet(line)?;
        match kind {
            CONNECT => {
                self.state().will = will_of(&body);
                line.write_all(&[0x20, 2, 0, 0])
            }
            SUBSCRIBE => {
                let count = filters(&body[2..]);
                let mut answer = vec![0x90, 2 + count, body[0], body[1]];
                answer.resize(4 + usize::from(count), 1);
                line.write_all(&answer)?;
                let mut state = self.state();
                for (topic, message) in &state.retained {
                    line.write_all(&packet(topic, message, true))?;
                }
                state.lines.push(line.try_clone()?);
                Ok(())
            }
            PUBLISH => {
                let (topic, rest) = text(&body);
                line.write_all(&[0x40, 2, rest[0], rest[1]])?;
                let topic = topic.strip_prefix(MACHINE).expect("a topic of the machine");
                self.on_message(topic, serde_json::from_slice(&rest[2..]).expect("JSON"));
                Ok(())
            }
            PING => line.write_all(&[0xD0, 0]),
            _ => Ok(()),
        }
    }

    fn on_message(&self, topic: &str, payload: Value) {
        let mut state = self.state();
        state.heard.push_back((topic.to_owned(), payload.clone()));
        if topic == PRESENCE {
            state.instance = payload["instance"].clone();
            let is_online = payload["online"] == true;
            state.retained.insert(topic.to_owned(), payload.clone());
            state.publish(topic, payload);
            drop(state);
            if is_online && self.accepts {
                self.publish("handler/cell/result", &json!({}));
            }
        }
    }
}

impl BrokerState {
    fn publish(&mut self, topic: &str, mut message: Value) {
        if message["instance"] == "$instance" {
            message["instance"] = self.instance.clone();
        }
        let packet = packet(topic, &message, false);
        self.lines.retain_mut(|line| line.write_all(&packet).is_ok());
    }
}

fn merged(defaults: &Value, members: &Value) -> Value {
    let mut whole: Map<String, Value> = defaults.as_object().expect("a known topic").clone();
    whole.extend(members.as_object().expect("members").clone());
    whole.into()
}

fn packet(topic: &str, message: &Value, is_retained: bool) -> Vec<u8> {
    let path = format!("{MACHINE}{topic}");
    let payload = message.to_string();
    let length = 2 + path.len() + payload.len();
    assert!(length < 128 * 128, "a short message");
    let [high, low] = u16::try_from(path.len()).expect("a short path").to_be_bytes();
    let of_length = [
        u8::try_from(length % 128).expect("7 bits") | 128,
        u8::try_from(length / 128).expect("7 bits"),
    ];
    let head = [
        PUBLISH << 4 | u8::from(is_retained),
        of_length[0],
        of_length[1],
        high,
        low,
    ];
    [&head[..], path.as_bytes(), payload.as_bytes()].concat()
}

fn read_packet(mut line: &TcpStream) -> io::Result<(u8, Vec<u8>)> {
    let (mut byte, mut length, mut shift) = ([0], 0, 0);
    line.read_exact(&mut byte)?;
    let kind = byte[0] >> 4;
    loop {
        line.read_exact(&mut byte)?;
        length |= usize::from(byte[0] & 127) << shift;
        shift += 7;
        if byte[0] < 128 {
            break;
        }
    }
    let mut body = vec![0; length];
    line.read_exact(&mut body)?;
    Ok((kind, body))
}

/// Splits a text with its length in front from the bytes after it.
fn text(bytes: &[u8]) -> (&str, &[u8]) {
    let end = 2 + usize::from(u16::from_be_bytes([bytes[0], bytes[1]]));
    (std::str::from_utf8(&bytes[2..end]).expect("UTF-8"), &bytes[end..])
}

fn will_of(connect: &[u8]) -> Value {
    let (_protocol, rest) = text(connect);
    let (_client_id, after) = text(&rest[4..]);
    if rest[1] & HAS_WILL == 0 {
        return Value::Null;
    }
    let (_topic, after) = text(after);
    serde_json::from_str(text(after).0).expect("JSON")
}

fn filters(mut bytes: &[u8]) -> u8 {
    let mut count = 0;
    while !bytes.is_empty() {
        bytes = &text(bytes).1[1..];
        count += 1;
    }
    count
}
