//! The page: served on this machine, unless told otherwise.

use crate::{Asked, Operator, VehicleView, Watch};
use axum::Router;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

const PAGE: &str = include_str!("page.html");

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum WebError {
    /// Another program has the port, or the address is not this machine's.
    #[error("{address}: {source}; choose another with --page")]
    Bind {
        /// Where it was to be.
        address: SocketAddr,
        /// Why it cannot be.
        source: std::io::Error,
    },
    /// Serving ended.
    #[error("{0}")]
    Serve(#[from] std::io::Error),
}

struct Ground {
    /// What this page is called by a browser: no other name leads here.
    address: std::sync::OnceLock<SocketAddr>,
    watch: Watch,
    operator: Operator,
}

/// Serves the page for as long as the process lives. `ready` is called with the address once it can be opened.
///
/// # Errors
/// The address cannot be had.
pub fn serve(
    address: SocketAddr,
    watch: Watch,
    operator: Operator,
    ready: impl FnOnce(SocketAddr),
) -> Result<(), WebError> {
    let ground = Arc::new(Ground { address: std::sync::OnceLock::new(), watch, operator });
    let app = Router::new()
        .route("/", get(|| async { Html(PAGE) }))
        .route("/state", get(state))
        .route("/drawing/{vehicle}", get(drawing))
        .route("/image/{vehicle}/{name}", get(image))
        .route("/command", post(command))
        .with_state(Arc::clone(&ground));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async move {
        let listener = tokio::net::TcpListener::bind(address).await;
        let listener = listener.map_err(|source| WebError::Bind { address, source })?;
        let address = *ground.address.get_or_init(|| listener.local_addr().unwrap_or(address));
        ready(address);
        tokio::spawn(stay_present(ground));
        axum::serve(listener, app).await?;
        Ok(())
    })
}

/// While this runs, its operator is there: the vehicles that he commands are told so.
async fn stay_present(ground: Arc<Ground>) {
    let mut each_second = tokio::time::interval(Duration::from_secs(1));
    loop {
        each_second.tick().await;
        let commanded = |vehicle: &&VehicleView| vehicle.connected && ground.operator.commands(&vehicle.name);
        for vehicle in ground.watch.views().iter().filter(commanded) {
            // Who is not heard cannot be told.
            let _ = ground.operator.tell_present(&vehicle.name);
        }
    }
}

async fn state(State(ground): State<Arc<Ground>>) -> Response {
    json_response(&json!({ "vehicles": ground.watch.views() }))
}

/// Of a vehicle that was not heard yet there is nothing yet: a page that knew it from a ground before is not wrong to ask.
async fn drawing(State(ground): State<Arc<Ground>>, Path(vehicle): Path<String>) -> Response {
    match ground.watch.drawing(&vehicle) {
        Some(drawing) => json_response(&drawing),
        None => StatusCode::NO_CONTENT.into_response(),
    }
}

/// Nothing yet, as a drawing.
async fn image(State(ground): State<Arc<Ground>>, Path((vehicle, name)): Path<(String, String)>) -> Response {
    let headers = [(header::CONTENT_TYPE, "image/jpeg"), (header::CACHE_CONTROL, "no-store")];
    match ground.watch.image(&vehicle, &name) {
        Some(bytes) => (headers, bytes).into_response(),
        None => StatusCode::NO_CONTENT.into_response(),
    }
}

/// Whether a request is to this page by its address, and from no other page: a name that somebody else gives to this
/// machine's address does not command.
fn is_own(headers: &HeaderMap, address: SocketAddr) -> bool {
    let own = [address.to_string(), format!("localhost:{}", address.port())];
    let text = |name| headers.get(name).and_then(|value: &axum::http::HeaderValue| value.to_str().ok());
    let host = text(header::HOST);
    let origin = text(header::ORIGIN).and_then(|origin| origin.strip_prefix("http://"));
    let is_known = |name: &str| own.iter().any(|own| own == name);
    host.is_some_and(is_known) && (headers.get(header::ORIGIN).is_none() || origin.is_some_and(is_known))
}

/// Asks a vehicle, and tells what became of it.
async fn command(State(ground): State<Arc<Ground>>, headers: HeaderMap, body: String) -> Response {
    if !ground.address.get().is_some_and(|address| address.ip().is_loopback()) {
        // Whoever reaches it would command by the operator's name and certificate.
        return (StatusCode::FORBIDDEN, "this page is served beyond its machine: only to look at").into_response();
    }
    if !ground.address.get().is_some_and(|address| is_own(&headers, *address)) {
        return (StatusCode::FORBIDDEN, "from another page").into_response();
    }
    let is_json = headers.get(header::CONTENT_TYPE).is_some_and(|kind| kind == "application/json");
    let asked = serde_json::from_str::<Asked>(&body);
    let asked = match asked {
        Ok(asked) if is_json => asked,
        Ok(_) => return (StatusCode::UNSUPPORTED_MEDIA_TYPE, "expected application/json").into_response(),
        Err(error) => return (StatusCode::BAD_REQUEST, error.to_string()).into_response(),
    };
    // Its answer is waited for.
    let answered = tokio::task::spawn_blocking(move || ground.operator.ask(&asked)).await;
    let value = match answered {
        Ok(Ok(())) => json!({ "accepted": true }),
        Ok(Err(error)) => json!({ "accepted": false, "reason": error.to_string() }),
        Err(error) => json!({ "accepted": false, "reason": error.to_string() }),
    };
    json_response(&value)
}

fn json_response(value: &Value) -> Response {
    let headers = [(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-store")];
    (headers, value.to_string()).into_response()
}
