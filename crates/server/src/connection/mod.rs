//! What stands around every request: the connection it comes on, its name, log and encodings.
//!
//! | file | holds |
//! |---|---|
//! | `accept` | the loop that accepts connections, and each connection's life |
//! | `socket` | the bytes of a connection, on their way to and from the HTTP library |
//! | `activity` | when a connection, or an answer on one, counts as dead |
//! | `body` | a request's body, whose end is seen |
//! | `record`, `request_id` | around each request: id, log, metrics |
//! | `decode`, `compress` | encodings of bodies, in and out |
//! | `head` | what HTTP asks of every head |
//! | `prefix` | the path under which a proxy offers the server |
//! | `fields` | what fields of a head say: weights, tags, ranges |
//! | `cors` | pages from other sites |

pub(crate) mod accept;
pub(crate) mod activity;
pub(crate) mod body;
pub(crate) mod compress;
pub(crate) mod content;
pub(crate) mod cors;
pub(crate) mod decode;
pub(crate) mod fields;
pub(crate) mod head;
pub(crate) mod prefix;
pub(crate) mod record;
pub(crate) mod request_id;
pub(crate) mod socket;
