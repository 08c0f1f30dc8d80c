//! A node of a cluster of rmqtt: `tandem-rmqtt-test NUMBER MQTT_PORT GRPC_PORT 1@HOST:PORT 2@HOST:PORT ...`, the addresses being
//! those of all nodes.

use std::time::Duration;

use rmqtt::context::ServerContext;
use rmqtt::net::Builder;
use rmqtt::node::Node;
use rmqtt::server::MqttServer;

type Failed = Box<dyn std::error::Error>;

#[tokio::main]
async fn main() -> Result<(), Failed> {
    let mut arguments = std::env::args().skip(1);
    let mut number = |what| arguments.next().ok_or(what);
    let id = number("the number of the node")?.parse()?;
    let mqtt: u16 = number("the port of MQTT")?.parse()?;
    let grpc: u16 = number("the port of gRPC")?.parse()?;
    let all: Vec<String> = arguments.map(|address| format!("\"{address}\"")).collect();
    let of_cluster = format!(
        "node_grpc_addrs = [{}]\nnode_grpc_client_timeout = \"1s\"\n",
        all.join(", ")
    );
    // retained messages do not expire
    let of_retainer = "storage.type = \"ram\"\nretained_message_ttl = \"0s\"\n";
    let context = ServerContext::new()
        .node(Node::new(id, 1000.0, 1000.0, Duration::from_secs(2)))
        .busy_check_enable(false)
        .plugins_config_map_add("rmqtt-cluster-broadcast", of_cluster)
        .plugins_config_map_add("rmqtt-retainer", of_retainer)
        .build()
        .await;
    context
        .node
        .start_grpc_server(context.clone(), ([127, 0, 0, 1], grpc).into(), true, false);
    rmqtt_retainer::register(&context, true, false).await?;
    rmqtt_cluster_broadcast::register(&context, true, false).await?;
    let listener = Builder::new()
        .name("tcp")
        .laddr(([127, 0, 0, 1], mqtt).into())
        // after an immediate restart, connections of the previous process of this node still wait
        .reuseaddr(Some(true))
        .bind()?
        .tcp()?;
    MqttServer::new(context).listener(listener).build().run().await?;
    Ok(())
}
