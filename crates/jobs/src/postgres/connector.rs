//! Connections that tell what the database does.

use std::future::poll_fn;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::mpsc::UnboundedSender;
use tokio::task::JoinSet;
use tokio_postgres::{AsyncMessage, Connection, NoTls};
use tokio_postgres_rustls::MakeRustlsConnect;

/// Makes connections that are none of the pool's.
#[derive(Clone)]
pub(super) struct Connector {
    pub(super) config: tokio_postgres::Config,
    pub(super) tls: Option<MakeRustlsConnect>,
    pub(super) schema: String,
    pub(super) deadline: Duration,
}

impl Connector {
    /// A connection whose messages go to `told`; it ends with the tasks.
    pub(super) async fn connect(
        &self,
        tasks: &mut JoinSet<()>,
        told: UnboundedSender<String>,
    ) -> Result<tokio_postgres::Client, tokio_postgres::Error> {
        match self.tls.clone() {
            Some(tls) => {
                let (client, connection) = self.config.connect(tls).await?;
                tasks.spawn(forward(connection, told));
                Ok(client)
            }
            None => {
                let (client, connection) = self.config.connect(NoTls).await?;
                tasks.spawn(forward(connection, told));
                Ok(client)
            }
        }
    }
}

/// Does a connection's work until it is lost.
async fn forward<S, T>(mut connection: Connection<S, T>, told: UnboundedSender<String>)
where
    S: AsyncRead + AsyncWrite + Unpin,
    T: AsyncRead + AsyncWrite + Unpin,
{
    while let Some(Ok(message)) = poll_fn(|context| connection.poll_message(context)).await {
        if let AsyncMessage::Notification(notice) = message {
            // Whoever listened may be gone.
            let _ = told.send(notice.payload().to_owned());
        }
    }
}
