//! The connection to the daemon: bytes there, answers back.

use crate::service::ingest::{Reply, tls};
use anyhow::{Context, bail};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, BufReader, WriteHalf};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::ServerName;

/// Longest time to connect.
const CONNECT: Duration = Duration::from_secs(10);

/// Longest time to wait for the reason of a closed connection.
const LAST_WORDS: Duration = Duration::from_secs(1);

/// Most bytes of all answers: the daemon sends little.
const MOST_ANSWERS: u64 = 1 << 30;

/// Address of the daemon.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// A host and its port.
    Tcp {
        /// Host name or IP address.
        host: String,
        /// Port.
        port: u16,
    },
    /// A Unix socket.
    Unix(PathBuf),
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp { host, port } if host.contains(':') => write!(f, "tcp://[{host}]:{port}"),
            Self::Tcp { host, port } => write!(f, "tcp://{host}:{port}"),
            Self::Unix(path) => write!(f, "unix://{}", path.display()),
        }
    }
}

impl FromStr for Address {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        const WANTED: &str = "write it as tcp://HOST:PORT or unix:///PATH";
        if let Some(path) = text.strip_prefix("unix://").filter(|path| !path.is_empty()) {
            return Ok(Self::Unix(PathBuf::from(path)));
        }
        let (host, port) = text
            .strip_prefix("tcp://")
            .and_then(|rest| rest.rsplit_once(':'))
            .ok_or(WANTED)?;
        let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
        let port = port.parse().map_err(|_| WANTED)?;
        if host.is_empty() {
            Err(WANTED)
        } else {
            Ok(Self::Tcp { host, port })
        }
    }
}

/// Certificate, key and trusted authority of the client.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct TlsArgs {
    /// TLS: authority of the daemon's certificate (PEM file).
    #[arg(long, value_name = "FILE", requires = "tls_certificate", requires = "tls_key")]
    pub tls_ca: Option<PathBuf>,

    /// TLS: certificate of this client (PEM file).
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    pub tls_certificate: Option<PathBuf>,

    /// TLS: private key of this client (PEM file).
    #[arg(long, value_name = "FILE", requires = "tls_ca")]
    pub tls_key: Option<PathBuf>,
}

impl TlsArgs {
    /// TLS connector, if TLS is wanted.
    ///
    /// # Errors
    /// A file cannot be used.
    pub fn connector(&self) -> anyhow::Result<Option<TlsConnector>> {
        match (&self.tls_ca, &self.tls_certificate, &self.tls_key) {
            (Some(authority), Some(certificate), Some(key)) => tls::connector(authority, certificate, key)
                .map(Some)
                .map_err(anyhow::Error::msg),
            _ => Ok(None),
        }
    }
}

trait Socket: AsyncRead + AsyncWrite + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Send + Unpin> Socket for T {}

/// A connection to the daemon.
pub(super) struct Link {
    output: WriteHalf<Box<dyn Socket>>,
    answers: mpsc::UnboundedReceiver<Reply>,
}

impl Link {
    /// Connects to the daemon.
    pub async fn open(to: &Address, tls: Option<&TlsConnector>) -> anyhow::Result<Self> {
        timeout(CONNECT, Self::connect(to, tls))
            .await
            .context("no connection within 10 s")?
            .with_context(|| to.to_string())
    }

    async fn connect(to: &Address, tls: Option<&TlsConnector>) -> anyhow::Result<Self> {
        let socket: Box<dyn Socket> = match (to, tls) {
            (Address::Unix(path), _) => Box::new(UnixStream::connect(path).await?),
            (Address::Tcp { host, port }, tls) => {
                let stream = TcpStream::connect((host.as_str(), *port)).await?;
                stream.set_nodelay(true)?;
                match tls {
                    Some(tls) => {
                        let name = ServerName::try_from(host.clone()).context("the host's name")?;
                        Box::new(tls.connect(name, stream).await.context("TLS")?)
                    }
                    None => Box::new(stream),
                }
            }
        };
        let (input, output) = tokio::io::split(socket);
        let (to, answers) = mpsc::unbounded_channel();
        tokio::spawn(async move {
            let mut lines = BufReader::new(input.take(MOST_ANSWERS)).lines();
            while let Ok(Some(line)) = lines.next_line().await {
                let reply = line
                    .parse()
                    .unwrap_or_else(|fault: crate::service::ingest::reply::Unknown| Reply::Error {
                        reason: fault.to_string(),
                        again: false,
                    });
                if to.send(reply).is_err() {
                    break;
                }
            }
        });
        Ok(Self { output, answers })
    }

    /// Sends bytes; answers that come meanwhile go to `on_answer`, whose error ends the sending.
    pub async fn send<E: From<std::io::Error>>(
        &mut self,
        bytes: &[u8],
        mut on_answer: impl FnMut(Reply) -> Result<(), E>,
    ) -> Result<(), E> {
        let Self { output, answers } = self;
        let mut sending = std::pin::pin!(async {
            output.write_all(bytes).await?;
            output.flush().await
        });
        let mut is_open = true;
        loop {
            tokio::select! {
                biased;
                answer = answers.recv(), if is_open => match answer {
                    Some(answer) => on_answer(answer)?,
                    // The sending side will report the fault.
                    None => is_open = false,
                },
                sent = &mut sending => {
                    // Why it failed may still be on its way.
                    let last = if sent.is_err() { timeout(LAST_WORDS, answers.recv()).await } else { Ok(None) };
                    if let Ok(Some(answer)) = last {
                        on_answer(answer)?;
                    }
                    return Ok(sent?);
                }
            }
        }
    }

    /// The next answer; `None` when the daemon closed the connection.
    pub async fn answer(&mut self) -> Option<Reply> {
        self.answers.recv().await
    }

    /// Sends a hello; returns the number of messages that the daemon has.
    pub async fn hello(&mut self, sender: &str, patience: Duration) -> anyhow::Result<Result<u64, Reply>> {
        let hello = serde_json::json!({"hello": {"sender": sender}});
        self.output.write_all(format!("{hello}\n").as_bytes()).await?;
        self.output.flush().await?;
        match timeout(patience, self.answer())
            .await
            .context("no answer to the hello")?
        {
            Some(Reply::Welcome { messages, .. }) => Ok(Ok(messages)),
            Some(other) => Ok(Err(other)),
            None => bail!("the connection was closed before the hello was answered"),
        }
    }
}
