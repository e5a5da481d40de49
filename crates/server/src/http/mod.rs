//! `POST /upsample`, and the pages for people and programs around it.
//!
//! | file | holds |
//! |---|---|
//! | `upsample` | the handler, from body to body |
//! | `asked` | a request that may be of any size: as a whole or in tiles |
//! | `query`, `form`, `accepted` | what a request asks for: parameters, forms, the format |
//! | `upload`, `download` | the body in and the body out |
//! | `openapi` | the interface described |
//! | `readiness` | whether the server takes requests |

pub(crate) mod accepted;
pub(crate) mod asked;
pub(crate) mod download;
pub(crate) mod filename;
pub(crate) mod form;
pub(crate) mod openapi;
pub(crate) mod query;
pub(crate) mod readiness;
pub(crate) mod upload;
pub(crate) mod upsample;
