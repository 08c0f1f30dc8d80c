//! Rows of requests about the control lease.

#![allow(
    clippy::result_large_err,
    reason = "a request of another row is returned unchanged"
)]

use super::answer::AnswerForm;
use super::path_parameter::CS;
use super::payloads::{LeaseBreak, NoArgs, break_lease, lease, release};
use super::right::Right::{Administrate, Operate};
use super::route::{Headers, Route};
use super::row::{IDEMPOTENCY_KEY, IDS, InboundTopic, LEASE_FENCE, RequestParts, Row};
use super::row_macros::written;
use super::subject::Subject;
use crate::types::command::CommandReply;
use crate::types::lease::{LeaseRelease, LeaseRequest, LeaseTake};
use crate::types::request::Request;

/// Row of the request that takes or renews the control lease.
pub(super) const TAKE: Row = Row {
    routes: &[Route::post::<LeaseTake>(
        Subject::Commands,
        "/cs/{cs}/lease",
        &[CS],
        "Takes the control lease, or renews it with its fence.",
    )
    .gives::<CommandReply>()
    .headers(Headers::Key)],
    topic: Some(
        InboundTopic::new::<LeaseTake>(
            "cs/{cs}/lease/{verb=take}",
            "Takes the control lease, or renews it with its fence: until it expires, only its holder may start motion.",
        )
        .envelope(IDS),
    ),
    takes_not_after: false,
    answer: |_| AnswerForm::Lease,
    ..Row::new(Operate, |incoming| lease(&incoming, |incoming| incoming.json().map(LeaseRequest::Take)),
        written!(Request::Lease { cs, request: LeaseRequest::Take(take), meta } => {
                let parts = RequestParts::for_coordinate_system(cs).with("verb", "take").json(&take);
                parts.header(IDEMPOTENCY_KEY, meta.command_id)
            }),
    )
};

/// Row of the request that releases the control lease.
pub(super) const RELEASE: Row = Row {
    routes: &[Route::new(
        "DELETE",
        Subject::Commands,
        "/cs/{cs}/lease",
        &[CS],
        "Releases the control lease; Lease-Fence contains its number.",
    )
    .gives::<CommandReply>()
    .headers(Headers::KeyAndFence)],
    topic: Some(
        InboundTopic::new::<LeaseRelease>("cs/{cs}/lease/{verb=release}", "Releases the control lease.")
            .envelope(IDS),
    ),
    takes_not_after: false,
    answer: |_| AnswerForm::Lease,
    ..Row::new(
        Operate,
        |incoming| lease(&incoming, release),
        written!(Request::Lease { cs, request: LeaseRequest::Release(release), meta } => {
            let parts = RequestParts::for_coordinate_system(cs).with("verb", "release").payload(&release);
            parts.header(IDEMPOTENCY_KEY, meta.command_id).header(LEASE_FENCE, release.fence)
        }),
    )
};

/// Row of the request that ends the control lease.
pub(super) const BREAK: Row = Row {
    routes: &[Route::post::<NoArgs>(
        Subject::Commands,
        "/cs/{cs}/lease/break",
        &[CS],
        "Ends the control lease, whoever holds it.",
    )
    .gives::<CommandReply>()
    .headers(Headers::Key)],
    topic: Some(
        InboundTopic::new::<LeaseBreak>(
            "cs/{cs}/lease/{verb=break}",
            "Ends the control lease, whoever holds it.",
        )
        .envelope(IDS),
    ),
    takes_not_after: false,
    answer: |_| AnswerForm::Lease,
    ..Row::new(
        Administrate,
        |incoming| lease(&incoming, break_lease),
        written!(Request::Lease { cs, request: LeaseRequest::Break, meta } => {
            let parts = RequestParts::for_coordinate_system(cs).with("verb", "break").json(&LeaseBreak {});
            parts.header(IDEMPOTENCY_KEY, meta.command_id)
        }),
    )
};
