//! Start and stop of all server ends together.

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

use super::*;
use crate::GatewayError;

#[tokio::test]
async fn a_taken_port_is_an_error_that_names_the_setting() {
    let taken = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let port: Arc<dyn ServedPort> = StubPort::new();
    for setting in ["[http] listen", "[mqtt] listen"] {
        let mut settings = settings();
        if setting == "[http] listen" {
            settings.http_listen.clone_from(&address);
        } else {
            settings.mqtt.embedded_listen = Some(address.clone());
        }
        let error = Gateway::start(Arc::clone(&port), settings).await.unwrap_err();
        assert!(matches!(error, GatewayError::PortTaken { .. }), "{error:?}");
        let text = error.to_string();
        assert!(text.contains(setting) && text.contains(&address), "{text}");
    }
}

#[tokio::test]
async fn an_address_that_the_network_reaches_is_refused() {
    let port: Arc<dyn ServedPort> = StubPort::new();
    let mut http = settings();
    http.http_listen = "0.0.0.0:0".into();
    let mut mqtt = settings();
    mqtt.mqtt.embedded_listen = Some("[::]:0".into());
    for settings in [http, mqtt] {
        let error = Gateway::start(Arc::clone(&port), settings).await.unwrap_err();
        assert!(matches!(error, GatewayError::NotLoopback { .. }), "{error:?}");
    }
}

#[tokio::test]
async fn http_answers_on_its_socket_and_its_port_is_free_after_the_shutdown() {
    let port = StubPort::new();
    let gateway = start(&port).await;
    let address = gateway.http_addr();
    let mut stream = TcpStream::connect(address).await.unwrap();
    let request = format!("GET /api/v1/health HTTP/1.1\r\nHost: {address}\r\n\r\n");
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = [0; 12];
    within(stream.read_exact(&mut answer)).await.unwrap();
    assert_eq!(&answer, b"HTTP/1.1 200");
    let mqtt = gateway.mqtt_addr().unwrap();
    // with the idle connection still open
    within(gateway.shutdown()).await;
    for address in [address, mqtt] {
        assert!(
            TcpStream::connect(address).await.is_err(),
            "{address} still listens"
        );
    }
}

#[tokio::test]
async fn with_an_external_broker_that_is_away_everything_else_works() {
    let port: Arc<dyn ServedPort> = StubPort::new();
    let mut settings = settings();
    settings.mqtt.embedded_listen = None;
    // the discard port, on which no program listens
    settings.mqtt.brokers = vec![("127.0.0.1".to_owned(), 9)];
    let gateway = Gateway::start(port, settings).await.unwrap();
    assert_eq!(gateway.mqtt_addr(), None);
    assert!(TcpStream::connect(gateway.http_addr()).await.is_ok());
    within(gateway.shutdown()).await;
}
