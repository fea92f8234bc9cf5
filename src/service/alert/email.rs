//! A mail through an SMTP server: delivered when the server has taken it for every recipient.

use super::{Failure, Message, Sink, What, digest};
use crate::config::settings::alert::{EmailSettings, MailSecurity};
use lettre::message::header::ContentType;
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, CertificateStore, Tls, TlsParameters};
use lettre::{SmtpTransport, Transport};
use std::error::Error;
use std::io;
use std::time::Duration;

/// Most alarms that one mail refers to.
const REFERENCES: usize = 20;

/// A mail server.
pub(super) struct Email {
    settings: EmailSettings,
    deadline: Duration,
}

impl Email {
    pub(super) fn new(settings: EmailSettings, deadline: Duration) -> Self {
        Self { settings, deadline }
    }

    fn failed(&self, error: impl std::fmt::Display) -> Failure {
        let EmailSettings { host, port, .. } = &self.settings;
        Failure::new(format!("mail server {host}:{port}: {error}"))
    }

    fn transport(&self) -> Result<SmtpTransport, Failure> {
        let settings = &self.settings;
        let tls = match settings.security {
            MailSecurity::Plain => Tls::None,
            MailSecurity::StartTls => Tls::Required(self.parameters()?),
            MailSecurity::Tls => Tls::Wrapper(self.parameters()?),
        };
        // `dangerous` is what the library calls a builder that is told everything; no password goes out unencrypted
        // because the configuration refuses that.
        let mut transport = SmtpTransport::builder_dangerous(&settings.host)
            .port(settings.port)
            .timeout(Some(self.deadline))
            .tls(tls);
        if let Some(login) = &settings.login {
            let password = login.password_file.read_line()?;
            transport = transport.credentials(Credentials::new(login.user.clone(), password));
        }
        Ok(transport.build())
    }

    fn parameters(&self) -> Result<TlsParameters, Failure> {
        let mut parameters = TlsParameters::builder(self.settings.host.clone());
        if let Some(file) = &self.settings.ca_file {
            let certificates = Certificate::from_pem(&file.read()?)
                .map_err(|error| Failure::new(format!("{}: {error}", file.as_str())))?;
            parameters = parameters
                .certificate_store(CertificateStore::None)
                .add_root_certificate(certificates);
        }
        parameters.build().map_err(|error| self.failed(error))
    }

    /// Mail about an alarm, or about several.
    fn mail(&self, messages: &[Message]) -> Result<lettre::Message, Failure> {
        let (id, subject, text) = match messages {
            [message] => (message.id.clone(), message.subject(), message.text()),
            all => {
                let last = all.last().map_or("", |message| message.id.as_str());
                let id = format!("{last}-with-{}", all.len().saturating_sub(1));
                (id, digest::subject(all), digest::text(all))
            }
        };
        // A mail client shows one mail for one id, and all mails of an alarm together.
        let domain = self.settings.from.email.domain();
        let mut mail = lettre::Message::builder()
            .from(self.settings.from.clone())
            .subject(subject)
            .message_id(Some(format!("<{id}@{domain}>")));
        let known = messages.iter().filter(|message| message.what != What::Test);
        let alarms: Vec<String> = known
            .take(REFERENCES)
            .map(|message| format!("<{}@{domain}>", message.conversation()))
            .collect();
        if !alarms.is_empty() {
            mail = mail.references(alarms.join(" "));
        }
        for to in &self.settings.to {
            mail = mail.to(to.clone());
        }
        mail.header(ContentType::TEXT_PLAIN)
            .body(text + "\n")
            .map_err(|error| self.failed(error))
    }
}

impl Sink for Email {
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        self.deliver_all(std::slice::from_ref(message))
    }

    fn gathers_for(&self) -> Duration {
        Duration::from_secs_f64(self.settings.group_s)
    }

    fn deliver_all(&mut self, messages: &[Message]) -> Result<(), Failure> {
        let mail = self.mail(messages)?;
        self.transport()?.send(&mail).map(|_| ()).map_err(|error| {
            if is_timeout(&error) {
                self.failed(format!("no answer within {:.0} s", self.deadline.as_secs_f64()))
            } else {
                self.failed(error)
            }
        })
    }
}

/// True if the system waited for the time limit; it has two names for that.
fn is_timeout(error: &(dyn Error + 'static)) -> bool {
    let kind = error.downcast_ref::<io::Error>().map(io::Error::kind);
    matches!(kind, Some(io::ErrorKind::TimedOut | io::ErrorKind::WouldBlock))
        || error.source().is_some_and(is_timeout)
}
