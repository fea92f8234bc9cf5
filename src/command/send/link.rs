//! The connection to the daemon: bytes there, answers back.

use crate::service::ingest::{Reply, tls};
use crate::site::clock;
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
use tokio_rustls::rustls::{self, AlertDescription};

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
    /// TLS connector, if TLS is wanted; warns of a certificate that ends soon.
    ///
    /// # Errors
    /// A file cannot be used, or the certificate has ended.
    pub fn connector(&self) -> anyhow::Result<Option<TlsConnector>> {
        let (Some(authority), Some(certificate), Some(key)) =
            (&self.tls_ca, &self.tls_certificate, &self.tls_key)
        else {
            return Ok(None);
        };
        let (connector, warning) =
            tls::connector(authority, certificate, key, clock::now_s()).map_err(anyhow::Error::msg)?;
        if let Some(warning) = warning {
            tell!("warning: {warning}");
        }
        Ok(Some(connector))
    }
}

trait Socket: AsyncRead + AsyncWrite + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Send + Unpin> Socket for T {}

/// Reason why TLS refuses for good: a certificate of ours or of theirs.
pub(super) fn refusal(fault: &std::io::Error) -> Option<String> {
    let fault = fault.get_ref()?.downcast_ref::<rustls::Error>()?;
    match fault {
        // TLS has one alert for both ends of the time of a certificate.
        rustls::Error::AlertReceived(AlertDescription::CertificateExpired) => Some(
            "it does not accept our certificate: by its clock it has ended, or is not valid yet (CertificateExpired)"
                .to_owned(),
        ),
        rustls::Error::AlertReceived(
            alert @ (AlertDescription::CertificateRevoked
            | AlertDescription::CertificateUnknown
            | AlertDescription::BadCertificate
            | AlertDescription::UnsupportedCertificate
            | AlertDescription::CertificateRequired
            | AlertDescription::UnknownCA
            | AlertDescription::AccessDenied
            | AlertDescription::DecryptError),
        ) => Some(format!("it does not accept our certificate ({alert:?})")),
        rustls::Error::InvalidCertificate(_) => Some(format!("its certificate is not accepted: {fault}")),
        _ => None,
    }
}

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
            loop {
                let line = match lines.next_line().await {
                    Ok(Some(line)) => line,
                    Ok(None) => break,
                    Err(fault) => {
                        // The last words of TLS; whoever sends sees any other fault.
                        if let Some(reason) = refusal(&fault) {
                            let _ = to.send(Reply::Error { reason, again: false });
                        }
                        break;
                    }
                };
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
        let said = async {
            self.output.write_all(format!("{hello}\n").as_bytes()).await?;
            self.output.flush().await
        };
        // Why it failed may still be on its way.
        let (fault, patience) = match said.await {
            Ok(()) => (None, patience),
            Err(fault) => (Some(fault), LAST_WORDS),
        };
        let answer = timeout(patience, self.answer()).await;
        if let (Some(fault), Err(_) | Ok(None)) = (fault, &answer) {
            return Err(fault.into());
        }
        match answer.context("no answer to the hello")? {
            Some(Reply::Welcome { messages, .. }) => Ok(Ok(messages)),
            Some(other) => Ok(Err(other)),
            None => bail!("the connection was closed before the hello was answered"),
        }
    }
}
