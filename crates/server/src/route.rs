//! The table of paths: what the router is made of, and what the description of the interface is held against.

use std::sync::Arc;

use axum::Router;
use axum::handler::Handler;
use axum::routing::{MethodFilter, MethodRouter, on};

use crate::app::App;

/// A row: a method, a path, and what answers there.
pub(crate) struct Route {
    #[cfg_attr(not(test), expect(dead_code, reason = "for the test of the description"))]
    pub(crate) method: &'static str,
    pub(crate) path: &'static str,
    handler: MethodRouter<Arc<App>>,
}

/// `GET`, and so `HEAD`.
pub(crate) fn get<H: Handler<T, Arc<App>>, T: 'static>(path: &'static str, handler: H) -> Route {
    Route { method: "get", path, handler: on(MethodFilter::GET, handler) }
}

/// `POST`.
pub(crate) fn post<H: Handler<T, Arc<App>>, T: 'static>(path: &'static str, handler: H) -> Route {
    Route { method: "post", path, handler: on(MethodFilter::POST, handler) }
}

/// `DELETE`.
pub(crate) fn delete<H: Handler<T, Arc<App>>, T: 'static>(path: &'static str, handler: H) -> Route {
    Route { method: "delete", path, handler: on(MethodFilter::DELETE, handler) }
}

/// A router of these rows; those of one path answer its methods.
pub(crate) fn router(routes: Vec<Route>) -> Router<Arc<App>> {
    routes.into_iter().fold(Router::new(), |router, route| router.route(route.path, route.handler))
}
