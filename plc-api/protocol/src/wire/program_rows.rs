//! Rows of requests about programs of the store, and about previews. None causes a motion.

#![allow(
    clippy::result_large_err,
    reason = "a request of another row is returned unchanged"
)]

use super::answer::{AnswerForm, ProgramList, json_of};
use super::parameter::Query;
use super::path_parameter::{CS, PROGRAM};
use super::payloads::{check_text, read_path, remove_program, store_program, upload};
use super::right::Right::{Administrate, Read};
use super::route::{Content, Headers, Route};
use super::row::{RequestParts, Row};
use super::row_macros::{carried, written};
use super::subject::Subject;
use crate::types::planned::{ManualText, PathQuery, Rehearsal};
use crate::types::program::{ProgramCheck, ProgramFolder};
use crate::types::request::Request;
use crate::types::upload::ProgramUpload;

/// Row of the request for the list of programs.
pub(super) const LIST: Row = Row {
    routes: &[
        Route::get(Subject::Programs, "/programs", &[], "Programs of the store.").gives::<ProgramList>(),
    ],
    answer: json_of::<ProgramList>,
    ..carried!(Read, Programs)
};

/// Row of the request for the text of a program.
pub(super) const TEXT: Row = Row {
    routes: &[Route::get(
        Subject::Programs,
        "/programs/{number}",
        &[PROGRAM],
        "Text of a program.",
    )
    .answered(200, Content::Text)
    .headers(Headers::Cached)],
    is_large: true,
    answer: |request| match request {
        Request::ReadProgram(_) => AnswerForm::Text,
        _ => AnswerForm::Program,
    },
    ..Row::new(
        Read,
        |incoming| Ok(Request::FetchProgram(incoming.number("number")?)),
        written!(Request::ReadProgram(number) | Request::FetchProgram(number) => {
            RequestParts::default().with("number", number)
        }),
    )
};

/// Row of the request to store a program.
pub(super) const STORE: Row = Row {
    routes: &[Route::new(
        "PUT",
        Subject::Programs,
        "/programs/{number}",
        &[PROGRAM],
        "Stores a program, even with errors.",
    )
    .takes(Content::Text)
    .gives::<ProgramCheck>()
    .or::<ProgramCheck>(201)
    .query(Query::DIALECT)
    .headers(Headers::Upload)],
    is_large: true,
    answer: |_| AnswerForm::Check,
    ..Row::new(Administrate, store_program, |request| match request {
        Request::WriteProgram(number, text) => Ok(upload(
            number,
            ProgramUpload {
                text,
                ..ProgramUpload::default()
            },
        )),
        Request::StoreProgram(number, said) => Ok(upload(number, said)),
        other => Err(other),
    })
};

/// Row of the request to delete a program.
pub(super) const REMOVE: Row = Row {
    routes: &[Route::new(
        "DELETE",
        Subject::Programs,
        "/programs/{number}",
        &[PROGRAM],
        "Deletes a program.",
    )
    .headers(Headers::Condition)],
    ..Row::new(
        Administrate,
        |incoming| remove_program(&incoming),
        |request| match request {
            Request::DeleteProgram(number) => Ok(RequestParts::default().with("number", number)),
            Request::RemoveProgram(number, condition) => Ok(RequestParts::default()
                .with("number", number)
                .condition(&condition)),
            other => Err(other),
        },
    )
};

/// Row of the request to check a program of the store.
pub(super) const CHECK: Row = Row {
    routes: &[Route::new(
        "POST",
        Subject::Programs,
        "/programs/{number}/check",
        &[PROGRAM],
        "Checks a program of the store.",
    )
    .gives::<ProgramCheck>()],
    answer: |_| AnswerForm::Check,
    ..carried!(Read, CheckProgram(number: number))
};

/// Row of the request for the intermediate code of a program.
pub(super) const INTERMEDIATE: Row = Row {
    routes: &[Route::get(
        Subject::Programs,
        "/programs/{number}/intermediate",
        &[PROGRAM],
        "Intermediate code of a program.",
    )
    .answered(200, Content::Text)
    .refusals(&[422])],
    is_large: true,
    answer: |_| AnswerForm::Text,
    ..carried!(Read, IntermediateCode(number: number))
};

/// Row of the request for the planned path of a program of the store.
pub(super) const PATH: Row = Row {
        routes: &[Route::get(
            Subject::Programs,
            "/programs/{number}/path",
            &[PROGRAM],
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
            Subject::Programs,
            "/programs/{number}/rehearsal",
            &[PROGRAM],
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
        Subject::Programs,
        "/programs/{number}/check_text",
        &[PROGRAM],
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
        Subject::Programs,
        "/programs/{number}/folder",
        &[PROGRAM],
        "Puts a program into a folder, by which lists are grouped; its text, its number and its hash do not change.",
    )],
    ..carried!(Administrate, PutInFolder(number: number, folder: json))
};

/// Row of the request for the path of manual data input.
pub(super) const MANUAL_PATH: Row = Row {
    routes: &[Route::post::<ManualText>(
        Subject::States,
        "/cs/{cs}/mdi/path",
        &[CS],
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
        Subject::States,
        "/cs/{cs}/mdi/rehearsal",
        &[CS],
        "The effects of a text if it ran as manual data input now, as far as they are planned; nothing moves.",
    )
    .gives::<Rehearsal>()
    .refusals(&[422])],
    answer: json_of::<Rehearsal>,
    ..carried!(Read, ManualRehearsal(cs: number, text: json))
};
