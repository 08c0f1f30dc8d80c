//! Server ends of the sequence-control interface: MQTT, REST, WebSocket, HMI.
