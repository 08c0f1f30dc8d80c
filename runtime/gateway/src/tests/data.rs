//! Variables, tools and work offsets over REST and MQTT.

use plc_protocol::types::data::{ToolChange, ToolData, ToolTable, VariableArea, WorkOffsetTable};
use plc_protocol::types::machine::AlarmRaise;
use plc_protocol::types::request::RefusalCode;
use serde_json::{Value, json};

use super::mqtt::TestClient;
use super::rest::{call, text};
use super::*;

const JSON: [(&str, &str); 1] = [("content-type", "application/json")];

fn machine() -> Arc<StubPort> {
    StubPort::with(|request| {
        Ok(match request {
            Request::ReadVariables { count, .. } => Answer::Variables(
                [1.5, f64::NAN]
                    .into_iter()
                    .cycle()
                    .take(*count as usize)
                    .collect(),
            ),
            Request::Tools => Answer::Tools(ToolTable {
                tools: vec![ToolData {
                    id: 3,
                    radius: 2.5,
                    length: 40.0,
                }],
            }),
            Request::WorkOffsets(9) => return Err(Refusal::new(RefusalCode::NotFound, "no 9")),
            Request::WorkOffsets(_) => Answer::WorkOffsets(g54()),
            _ => Answer::Done,
        })
    })
}

#[tokio::test]
async fn an_alarm_is_raised_for_one_coordinate_system_or_for_all() {
    let port = StubPort::new();
    for (body, cs) in [
        (json!({"cs": 2, "code": 20, "text": "low"}), Some(2)),
        (json!({"code": 20, "text": "low"}), None),
    ] {
        let response = call(&port, "POST", "/api/v1/alarms", &JSON, body.to_string()).await;
        assert_eq!(response.status(), 204);
        let text = "low".to_owned();
        let raise = AlarmRaise { cs, code: 20, text };
        assert_eq!(port.asked().pop(), Some(Request::RaiseAlarm(raise)));
    }
    let unknown = json!({"code": 20, "text": "low", "colour": "red"}).to_string();
    let response = call(&port, "POST", "/api/v1/alarms", &JSON, unknown).await;
    assert_eq!(response.status(), 400);
}

fn g54() -> WorkOffsetTable {
    let axes = [("X".to_owned(), 10.0)].into();
    WorkOffsetTable {
        work_offsets: [("G54".to_owned(), axes)].into(),
    }
}

async fn get(port: &Arc<StubPort>, path: &str) -> (u16, Value) {
    let response = call(port, "GET", &format!("/api/v1{path}"), &[], "").await;
    let status = response.status().as_u16();
    (status, serde_json::from_str(&text(response).await).unwrap())
}

async fn put(port: &Arc<StubPort>, path: &str, body: Value) -> u16 {
    let response = call(port, "PUT", &format!("/api/v1{path}"), &JSON, body.to_string()).await;
    response.status().as_u16()
}

#[tokio::test]
async fn rest_reads_ranges_tools_and_offsets() {
    let port = machine();
    let (_, one) = get(&port, "/variables/p?from=7").await;
    assert_eq!(one, json!({"kind": "P", "from": 7, "values": [1.5]}));
    let (_, three) = get(&port, "/cs/2/variables/q?from=0&count=3").await;
    assert_eq!(
        three,
        json!({"kind": "Q", "from": 0, "values": [1.5, "NaN", 1.5]})
    );
    let tool = json!({"tools": [{"id": 3, "radius": 2.5, "length": 40.0}]});
    assert_eq!(get(&port, "/tools").await, (200, tool));
    let offsets = json!({"work_offsets": {"G54": {"X": 10.0}}});
    assert_eq!(get(&port, "/cs/1/work_offsets").await, (200, offsets));
    let (status, problem) = get(&port, "/cs/9/work_offsets").await;
    assert_eq!((status, &problem["code"]), (404, &json!("not_found")));
    assert_eq!(get(&port, "/variables/p?from=-1").await.0, 400);
    assert_eq!(get(&port, "/variables/p?form=1").await.0, 400);
}

#[tokio::test]
async fn rest_sets_ranges_tools_and_offsets() {
    let port = machine();
    let values = json!({"values": [1, "-inf"]});
    assert_eq!(
        put(&port, "/variables/p?from=7&count=2", values.clone()).await,
        204
    );
    assert_eq!(put(&port, "/cs/2/variables/q?from=0", values.clone()).await, 204);
    let change = json!({"tools": [{"id": 4, "length": 12.5}], "remove": [3]});
    assert_eq!(put(&port, "/tools", change).await, 204);
    let offsets = json!({"work_offsets": {"G54": {"X": 10.0}}});
    assert_eq!(put(&port, "/cs/1/work_offsets", offsets).await, 204);
    let write = |area, from| Request::WriteVariables {
        area,
        from,
        values: vec![1.0, f64::NEG_INFINITY],
        meta: None,
    };
    let tool = ToolData {
        id: 4,
        radius: 0.0,
        length: 12.5,
    };
    let asked = [
        write(VariableArea::Global, 7),
        write(VariableArea::CoordinateSystem(2), 0),
        Request::WriteTools(ToolChange {
            tools: vec![tool],
            remove: vec![3],
        }),
        Request::WriteWorkOffsets(1, g54()),
    ];
    assert_eq!(port.asked(), asked);
    assert_eq!(put(&port, "/variables/p?from=0&count=3", values).await, 400);
    assert_eq!(
        put(&port, "/variables/p?from=0", json!({"values": [null]})).await,
        400
    );
    assert_eq!(put(&port, "/variables/p?from=0", json!({})).await, 400);
    assert_eq!(
        put(&port, "/tools", json!({"tools": [{"id": 4, "lenght": 1}]})).await,
        400
    );
    assert_eq!(port.asked().len(), asked.len());
}

#[tokio::test]
async fn a_write_of_variables_without_the_number_of_the_first_is_refused() {
    let port = machine();
    for path in ["/variables/p", "/cs/2/variables/q", "/variables/p?count=1"] {
        let response = call(
            &port,
            "PUT",
            &format!("/api/v1{path}"),
            &JSON,
            json!({"values": [7]}).to_string(),
        )
        .await;
        assert_eq!(response.status(), 400, "{path}");
        let text = text(response).await;
        assert!(text.contains("the query lacks from"), "{text}");
    }
    assert_eq!(port.asked(), []);
}

#[tokio::test]
async fn get_body_of_variables_is_accepted_by_put_if_path_and_query_match() {
    let port = machine();
    let (_, read) = get(&port, "/variables/p?from=7&count=2").await;
    assert_eq!(put(&port, "/variables/p?from=7", read.clone()).await, 204);
    let write = Request::WriteVariables {
        area: VariableArea::Global,
        from: 7,
        values: vec![1.5, f64::NAN],
        meta: None,
    };
    assert_eq!(
        format!("{:?}", port.asked().last().unwrap()),
        format!("{write:?}")
    );
    let count = port.asked().len();
    assert_eq!(put(&port, "/variables/p?from=8", read.clone()).await, 400);
    assert_eq!(put(&port, "/cs/1/variables/q?from=7", read).await, 400);
    assert_eq!(port.asked().len(), count);
}

#[tokio::test]
async fn a_retained_variable_set_is_refused_with_a_reply_and_a_warning() {
    let port = machine();
    let gateway = start(&port).await;
    let mut client =
        TestClient::connect(gateway.mqtt_addr().unwrap(), "hmi", &["presence", "reply/hmi"]).await;
    client.next("presence", |value| value["online"] == true).await;
    let set = json!({"command_id": "v", "client_id": "hmi", "kind": "P", "from": 0, "values": [1.0]});
    client.publish("cs/1/variable/set", true, &set).await;
    let (_, reply) = client.next("reply/hmi", |_| true).await;
    assert_eq!(
        (&reply["status"], &reply["code"]),
        (&json!("rejected"), &json!("retained"))
    );
    assert_eq!(port.warnings().len(), 1);
    assert!(
        !port
            .asked()
            .iter()
            .any(|request| matches!(request, Request::WriteVariables { .. }))
    );
    gateway.shutdown().await;
}
