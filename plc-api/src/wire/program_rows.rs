//! Rows of requests about programs that cause no motion.

#![allow(
    clippy::result_large_err,
    reason = "a request of another row is returned unchanged"
)]

use super::answer::{AnswerForm, json_of};
use super::parameter::Query;
use super::payloads::{check_text, read_path};
use super::right::Right::{Administrate, Read};
use super::route::{Content, Headers, Route};
use super::row::{RequestParts, Row};
use super::row_macros::{carried, written};
use crate::types::planned::{ManualText, PathQuery, Rehearsal};
use crate::types::program::{ProgramCheck, ProgramFolder};
use crate::types::request::Request;

/// Row of the request for the planned path of a program of the store.
pub(super) const PATH: Row = Row {
        routes: &[Route::get(
            "/programs/{number}/path",
            "The path of a program if it ran now, as far as it is planned, as bytes; the book describes their format.",
        )
        .answered(200, Content::Bytes)
        .query(Query::PATH)
        .headers(Headers::Cached)
        .refusals(&[400, 422])],
        is_large: true,
        answer: |_| AnswerForm::Path,
        ..Row::new(Read, |incoming| Ok(Request::PlannedPath(incoming.number("number")?, read_path(&incoming)?)),
            written!(Request::PlannedPath(number, query) => {
                    let PathQuery { cs, tolerance, from, count } = query;
                    let parts = RequestParts::default().with("number", number).query("from", from);
                    parts.queried("cs", cs).queried("tolerance", tolerance).queried("count", count)
                }),
        )
    };

/// Row of the request for the rehearsal of a program of the store.
pub(super) const REHEARSAL: Row = Row {
        routes: &[Route::get(
            "/programs/{number}/rehearsal",
            "The effects of a program if it ran now, as far as they are planned; for the run in progress, the time left.",
        )
        .gives::<Rehearsal>()
        .query(Query::RUN_BY)
        .refusals(&[400, 422])],
        answer: json_of::<Rehearsal>,
        ..Row::new(Read, |incoming| Ok(Request::Rehearsal(incoming.number("number")?, incoming.query.cs)),
            written!(Request::Rehearsal(number, cs) => RequestParts::default().with("number", number).queried("cs", cs)),
        )
    };

/// Row of the request to check a text that is not stored.
pub(super) const CHECK_TEXT: Row = Row {
    routes: &[Route::new(
        "POST",
        "/programs/{number}/check_text",
        "Checks a text as if it were this program; nothing is stored.",
    )
    .takes(Content::Text)
    .gives::<ProgramCheck>()
    .query(Query::DIALECT)],
    is_large: true,
    answer: json_of::<ProgramCheck>,
    ..Row::new(
        Read,
        check_text,
        written!(Request::CheckText(number, dialect, text) => {
            RequestParts::default().with("number", number).text(text).queried("dialect", dialect)
        }),
    )
};

/// Row of the request to put a program into a folder.
pub(super) const FOLDER: Row = Row {
    routes: &[Route::put::<ProgramFolder>(
        "/programs/{number}/folder",
        "Puts a program into a folder, by which lists are grouped; its text, its number and its hash do not change.",
    )],
    ..carried!(Administrate, PutInFolder(number: number, folder: json))
};

/// Row of the request for the path of manual data input.
pub(super) const MANUAL_PATH: Row = Row {
    routes: &[Route::post::<ManualText>(
        "/cs/{cs}/mdi/path",
        "The path of a text if it ran as manual data input now, as bytes; the book describes their format; nothing moves.",
    )
    .answered(200, Content::Bytes)
    .refusals(&[422])],
    answer: |_| AnswerForm::Path,
    ..carried!(Read, ManualPath(cs: number, text: json))
};

/// Row of the request for the rehearsal of manual data input.
pub(super) const MANUAL_REHEARSAL: Row = Row {
    routes: &[Route::post::<ManualText>(
        "/cs/{cs}/mdi/rehearsal",
        "The effects of a text if it ran as manual data input now, as far as they are planned; nothing moves.",
    )
    .gives::<Rehearsal>()
    .refusals(&[422])],
    answer: json_of::<Rehearsal>,
    ..carried!(Read, ManualRehearsal(cs: number, text: json))
};
