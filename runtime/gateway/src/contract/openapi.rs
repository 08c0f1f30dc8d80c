//! The OpenAPI 3.1 document, from the table of routes.

use serde_json::{Map, Value, json};

use plc_protocol::wire::parameter::Values;
use plc_protocol::wire::right::Right;
use plc_protocol::wire::route::{Content, Headers, Route};
use plc_protocol::wire::subject::Subject;

use super::routes::{ROUTES, Serves};
use super::schemas::{Schemas, body_of, reference};

pub(super) fn document(schemas: &Schemas) -> Value {
    let mut paths = Map::new();
    for (path, places) in ROUTES.iter() {
        let of_path = places.iter();
        let operations =
            of_path.map(|(route, serves)| (route.method.to_lowercase(), operation(route, *serves)));
        paths.insert(path.clone(), operations.collect::<Map<_, _>>().into());
    }
    let mut schemas: Value = schemas.clone().into();
    for_generators(&mut schemas);
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Tandem",
            "version": "1",
            "description": "Programs, commands, states and values of one machine. Refusals are problem \
                            details (RFC 9457) with a machine-readable code. If the machine has a token \
                            file, each request must carry a token. x-right is the right that a request \
                            needs. Roles with each right: read: all roles; operate: operate and admin; \
                            handle: handler and admin; reset and raise: operate, handler and admin; set: \
                            operate, admin, and handler in coordinate systems in which it serves an M code; \
                            administrate: admin.",
            "license": {"name": "Apache-2.0 OR MIT", "identifier": "Apache-2.0 OR MIT"},
        },
        "servers": [{"url": "/api/v1"}],
        "security": [{"token": []}, {}],
        "tags": Subject::ALL.map(|subject| json!({"name": subject.name(), "description": subject.description()})),
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}},
        },
    })
}

/// Rewrites a schema so that client generators understand it; some of them generate invalid code from the original.
fn for_generators(schema: &mut Value) {
    match schema {
        Value::Object(fields) => {
            name_letters(fields);
            list_words(fields);
            fields.values_mut().for_each(for_generators);
        }
        Value::Array(items) => items.iter_mut().for_each(for_generators),
        _ => {}
    }
}

/// Describes an object that has a member for each letter by the names of its members: a member `D` clashes with a
/// variable of generated code.
fn name_letters(fields: &mut Map<String, Value>) {
    const LETTERS: [&str; 8] = ["A", "B", "C", "D", "E", "F", "G", "H"];
    let members = fields.get("properties").and_then(Value::as_object);
    if !members.is_some_and(|members| members.keys().eq(LETTERS)) {
        return;
    }
    let mut member = fields["properties"]["A"].clone();
    if let Some(member) = member.as_object_mut() {
        member.remove("description");
    }
    fields.remove("properties");
    fields.insert("propertyNames".into(), json!({"enum": LETTERS}));
    fields.insert("additionalProperties".into(), member);
}

/// Replaces a choice of constants by a list of words and puts their meanings into the description: generated code takes
/// the first of several constants for the only one.
fn list_words(fields: &mut Map<String, Value>) {
    let choices = fields.get("oneOf").and_then(Value::as_array);
    let Some(choices) = choices.filter(|choices| choices.iter().all(|choice| choice["const"].is_string()))
    else {
        return;
    };
    let words: Vec<Value> = choices.iter().map(|choice| choice["const"].clone()).collect();
    let description = fields.get("description").and_then(Value::as_str);
    let meanings = choices.iter().filter_map(|choice| {
        let (word, meaning) = (choice["const"].as_str()?, choice["description"].as_str()?);
        Some(format!("\n- `{word}`: {}", meaning.replace('\n', " ")))
    });
    let description = description
        .map(str::to_owned)
        .into_iter()
        .chain(meanings)
        .collect::<String>();
    fields.remove("oneOf");
    fields.insert("type".into(), "string".into());
    fields.insert("enum".into(), words.into());
    fields.insert("description".into(), description.trim_start().into());
}

fn operation(route: &Route, serves: Serves) -> Value {
    let right = serves.right();
    let is_limited_in_age = serves.takes_not_after() && matches!(route.body, Content::Json(_));
    let mut operation = json!({
        "operationId": operation_id(route),
        "tags": [route.subject.name()],
        "summary": route.summary,
        "parameters": parameters(route),
        "responses": responses(route, serves, is_limited_in_age),
    });
    if let Some(right) = right {
        operation["x-right"] = right.wire_name().into();
    } else {
        operation["security"] = json!([]);
    }
    let body = match route.body {
        Content::Nothing => return operation,
        Content::Json(form) => {
            let (name, schema) = body_of(route, form, is_limited_in_age);
            // if an empty object suffices, the body is optional
            let required = schema["required"]
                .as_array()
                .is_some_and(|names| !names.is_empty());
            json!({"required": required, "content": {"application/json": {"schema": reference(&name)}}})
        }
        Content::Document => {
            json!({"required": true, "content": {"application/json": {"schema": {"type": "object"}}}})
        }
        Content::Text => {
            // the second one has the same meaning, for generators without text bodies
            let bytes = json!({"type": "string", "format": "binary"});
            json!({"required": false, "content": {
                "text/plain": {"schema": {"type": "string"}},
                "application/octet-stream": {"schema": bytes},
            }})
        }
        Content::Bytes => json!({"required": true, "content": {"application/octet-stream": {}}}),
    };
    operation["requestBody"] = body;
    operation
}

fn operation_id(route: &Route) -> String {
    let path = route.path().trim_start_matches('/').replace(['{', '}'], "");
    format!(
        "{}_{}",
        route.method.to_lowercase(),
        path.replace(['/', '.'], "_")
    )
}

fn parameters(route: &Route) -> Vec<Value> {
    let in_path = route.params.iter().map(|param| {
        let schema = schema_of(&param.values);
        json!({"name": param.name, "in": "path", "required": true, "schema": schema})
    });
    let listed = |name: &str, place: &str, values: &Values, description: &str, is_required: bool| {
        let schema = schema_of(values);
        let mut parameter = json!({"name": name, "in": place, "schema": schema, "description": description});
        if is_required {
            parameter["required"] = true.into();
        }
        parameter
    };
    let headers = route.headers.parameters().iter();
    let in_header = headers.map(|header| {
        listed(
            header.name,
            "header",
            &header.values,
            header.description,
            header.is_required,
        )
    });
    let queries = route.query.parameters.iter();
    let in_query = queries.map(|query| {
        listed(
            query.name,
            "query",
            &query.values,
            query.description,
            query.is_required,
        )
    });
    in_path.chain(in_header).chain(in_query).collect()
}

fn schema_of(values: &Values) -> Value {
    match values {
        Values::Integer(min, Some(max)) => json!({"type": "integer", "minimum": min, "maximum": max}),
        Values::Integer(min, None) => json!({"type": "integer", "minimum": min}),
        Values::Number(min) => json!({"type": "number", "minimum": min}),
        Values::Text(min, max) => json!({"type": "string", "minLength": min, "maxLength": max}),
        Values::AnyText => json!({"type": "string"}),
        Values::Words(words) => json!({"type": "string", "enum": words}),
        Values::Form(form) => json!({"type": "string", "pattern": form}),
    }
}

fn responses(route: &Route, serves: Serves, is_limited_in_age: bool) -> Value {
    let mut responses = Map::new();
    for (status, content) in route.answers() {
        let content = match content {
            Content::Nothing => None,
            Content::Json(form) => Some(json!({"application/json": {"schema": reference(&(form.name)())}})),
            Content::Document => Some(json!({"application/json": {"schema": {"type": "object"}}})),
            Content::Text => Some(json!({"text/plain": {"schema": {"type": "string"}}})),
            Content::Bytes => Some(
                json!({"application/octet-stream": {"schema": {"type": "string", "contentMediaType": "application/octet-stream"}}}),
            ),
        };
        let description = match status {
            101 => "The connection is a WebSocket.",
            201 => "New.",
            202 => "Accepted; Location is the path of the result.",
            204 => "Done.",
            _ => "The requested data.",
        };
        let mut response = json!({"description": description});
        if let Some(content) = content {
            response["content"] = content;
        }
        if let Some(headers) = response_headers(route, serves, status) {
            response["headers"] = headers;
        }
        responses.insert(status.to_string(), response);
    }
    if route.headers == Headers::Cached {
        let headers = response_headers(route, serves, 200);
        responses.insert(
            "304".to_owned(),
            json!({"description": "The client already has the current data.", "headers": headers}),
        );
    }
    for status in refusals(route, serves.right(), is_limited_in_age) {
        let mut refusal = json!({
            "description": refusal_text(status),
            "content": {"application/problem+json": {"schema": reference("Problem")}},
        });
        if let Some(headers) = refusal_headers(status) {
            refusal["headers"] = headers;
        }
        responses.insert(status.to_string(), refusal);
    }
    responses.into()
}

/// Headers of a rejection.
fn refusal_headers(status: u16) -> Option<Value> {
    match status {
        401 => Some(
            json!({"WWW-Authenticate": {"schema": {"type": "string", "enum": ["Bearer"]}, "description": "A token is needed."}}),
        ),
        429 => Some(
            json!({"Retry-After": {"schema": {"type": "integer", "minimum": 1}, "description": "Seconds after which the request can be repeated."}}),
        ),
        _ => None,
    }
}

/// Headers of a response.
fn response_headers(route: &Route, serves: Serves, status: u16) -> Option<Value> {
    let says = |description: &str| {
        let header = json!({"schema": {"type": "string"}, "description": description});
        Some(json!({"ETag": header}))
    };
    let is_path = matches!(route.answer.1, Content::Bytes);
    match status {
        201 if route.headers == Headers::Command => Some(
            json!({"Location": {"schema": {"type": "string"}, "description": "Path of the new object."}}),
        ),
        202 => Some(
            json!({"Location": {"schema": {"type": "string"}, "description": "Path of the command's progress."}}),
        ),
        200 | 201 if matches!(route.headers, Headers::Cached | Headers::Upload) => {
            says("The hash of the program, in quotes.")
        }
        200 if is_path => says("A tag that identifies this path, in quotes."),
        200 if matches!(serves, Serves::State(_)) => says("The revision of the state, in quotes."),
        _ => None,
    }
}

/// Returns the status codes of a route's rejections, each with problem details. `is_limited_in_age`: the body may
/// contain `not_after`.
fn refusals(route: &Route, right: Option<Right>, is_limited_in_age: bool) -> Vec<u16> {
    let changes = !matches!(right, None | Some(Right::Read));
    let of = [
        (true, &[403][..]),
        (right.is_some(), &[401, 429, 503]),
        (route.names().next().is_some(), &[404]),
        (!matches!(route.body, Content::Nothing), &[400, 408, 413, 415]),
        (changes, &[404, 409]),
        (is_limited_in_age, &[412]),
        // a key that a command has used before returns the stored response of that command
        (route.headers.has_key(), &[400, 412, 422]),
        (
            matches!(route.headers, Headers::Condition | Headers::Upload),
            &[400, 412],
        ),
        (true, route.refusals),
    ];
    let all = of.iter().filter(|(does, _)| *does);
    all.flat_map(|(_, statuses)| statuses.iter().copied()).collect()
}

fn refusal_text(status: u16) -> &'static str {
    match status {
        400 => "The request is malformed, or a value is out of its range.",
        401 => "A token is needed.",
        403 => "The role lacks the right, or Origin or Host is foreign.",
        404 => "The object does not exist.",
        408 => "The body did not arrive within the time limit.",
        409 => "The state does not allow it.",
        412 => "The condition is not met, or the request is older than its age limit.",
        413 => "The body is larger than the limit.",
        415 => "The body has a wrong type.",
        422 => "The program has errors, is not signed, or has another dialect.",
        426 => "This path needs a WebSocket.",
        429 => "Too many requests.",
        _ => "The machine cannot execute the request now.",
    }
}
