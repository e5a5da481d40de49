//! Calls of a store that block, whichever thread makes them.

use std::future::Future;
use std::io;
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Mutex, PoisonError};

use tokio::runtime::{Builder, Handle};
use tokio::task::AbortHandle;

use super::Place;
use super::fault;

/// What all stores of the program run on; it stays until the program ends.
static RUNTIME: Mutex<Option<Handle>> = Mutex::new(None);

/// Gives it, and makes it the first time.
pub(super) fn runtime() -> io::Result<Handle> {
    let mut made = RUNTIME.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(handle) = &*made {
        return Ok(handle.clone());
    }
    // Whoever was first may have chosen another.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let mut builder = Builder::new_multi_thread();
    let runtime = builder.worker_threads(1).thread_name("blobs").enable_all().build()?;
    let handle = runtime.handle().clone();
    // A runtime may not be dropped where others run.
    std::mem::forget(runtime);
    Ok(made.insert(handle).clone())
}

/// A call that is under way.
pub(super) struct Call<T> {
    answer: Receiver<io::Result<T>>,
    task: AbortHandle,
}

impl<T> Call<T> {
    /// Waits for its end.
    pub(super) fn wait(self) -> io::Result<T> {
        self.answer.recv().unwrap_or_else(|_| Err(io::Error::other("the call of the store broke off")))
    }

    /// Breaks it off.
    pub(super) fn cancel(self) {
        self.task.abort();
    }
}

impl Place {
    /// Begins a call about an object.
    pub(super) fn begin<T: Send + 'static>(
        &self,
        key: &str,
        call: impl Future<Output = object_store::Result<T>> + Send + 'static,
    ) -> Call<T> {
        let (tell, answer) = sync_channel(1);
        let (address, patience) = (format!("{}/{key}", self.bucket), self.patience.step);
        let task = self.runtime.spawn(async move {
            let told = match tokio::time::timeout(patience, call).await {
                Ok(told) => told.map_err(|error| fault::told(&address, &error)),
                Err(_) => Err(fault::late(&address)),
            };
            // Nobody may listen any more.
            let _ = tell.send(told);
        });
        Call { answer, task: task.abort_handle() }
    }

    /// Makes a call about an object.
    pub(super) fn call<T: Send + 'static>(
        &self,
        key: &str,
        call: impl Future<Output = object_store::Result<T>> + Send + 'static,
    ) -> io::Result<T> {
        self.begin(key, call).wait()
    }
}
