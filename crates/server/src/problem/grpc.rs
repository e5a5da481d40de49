//! A problem as a gRPC status, with the details of `google.rpc`.

use std::collections::HashMap;

use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use super::{Problem, Row};

/// The most characters of a problem's words in a gRPC status, which is sent as headers.
const LONGEST_STATUS: usize = 1000;

impl Problem {
    /// The same for gRPC. Its code follows from the status, so that there is one table.
    pub(crate) fn grpc(&self, request_id: &str) -> Status {
        let Row { status, name, setting, .. } = self.row();
        let code = match (self, status.as_u16()) {
            // No such method, in gRPC's words.
            (Self::NotFound | Self::MethodNotAllowed, _) => Code::Unimplemented,
            (_, 400 | 406 | 411 | 415 | 422) => Code::InvalidArgument,
            (_, 401) => Code::Unauthenticated,
            (_, 403) => Code::PermissionDenied,
            (_, 404) => Code::NotFound,
            (_, 408 | 504) => Code::DeadlineExceeded,
            (_, 409) => Code::FailedPrecondition,
            (_, 413 | 429 | 507) => Code::ResourceExhausted,
            (_, 416) => Code::OutOfRange,
            (_, 501) => Code::Unimplemented,
            (_, 503) => Code::Unavailable,
            _ => Code::Internal,
        };
        let words = match self {
            Self::NotFound | Self::MethodNotAllowed => {
                "no such method; reflection lists those that there are".to_owned()
            }
            _ => self.to_string(),
        };
        let words: String = words.chars().take(LONGEST_STATUS).collect();
        let mut details = ErrorDetails::new();
        let told =
            [("limit", self.limit().map(|limit| limit.to_string())), ("setting", setting.map(str::to_owned))];
        let told = told.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?)));
        details.set_error_info(
            name.to_uppercase().replace('-', "_"),
            "densecloud",
            told.collect::<HashMap<_, _>>(),
        );
        details.set_request_info(request_id, "");
        if let Some(wait) = self.retry_after() {
            details.set_retry_info(Some(wait));
        }
        if let Self::Parameter { name, why } = self {
            details.add_bad_request_violation(name, why.chars().take(LONGEST_STATUS).collect::<String>());
        }
        Status::with_error_details(code, words, details)
    }
}
