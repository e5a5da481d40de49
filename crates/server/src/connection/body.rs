//! A request's body, whose end is seen.

use std::pin::Pin;
use std::task::{Context, Poll};

use axum::body::Bytes;
use hyper::body::{Body, Frame, Incoming, SizeHint};

use crate::connection::activity::{Activity, Receiving};

/// A body as it comes from the client. What comes on HTTP/1 is not the next head before this is over, whatever has been
/// answered by then.
pub(crate) struct Watched {
    body: Incoming,
    receiving: Option<Receiving>,
}

impl Watched {
    pub(crate) fn new(body: Incoming, activity: &Activity) -> Self {
        let receiving = (!body.is_end_stream()).then(|| activity.receiving());
        Self { body, receiving }
    }
}

impl Body for Watched {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(context);
        let over = matches!(polled, Poll::Ready(None | Some(Err(_))));
        if over || self.body.is_end_stream() {
            self.receiving = None;
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}
