//! Shared parts of the tests: the built command, machines, simulations, served runtimes and their clients.

pub mod aedes;
pub mod binary;
pub mod broker;
pub mod cluster;
pub mod formula;
pub mod http;
pub mod machine;
pub mod mqtt;
pub mod nats;
pub mod rmqtt;
pub mod schemas;
pub mod served;
pub mod simulated;
pub mod wait;
pub mod wire;
