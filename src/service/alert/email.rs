//! A mail through an SMTP server: delivered when the server has taken it for every recipient.

use super::{Failure, Message, Sink, What};
use crate::config::settings::alert::{EmailSettings, MailSecurity};
use lettre::message::header::ContentType;
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, CertificateStore, Tls, TlsParameters};
use lettre::{SmtpTransport, Transport};
use std::error::Error;
use std::io;
use std::time::Duration;

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

    fn mail(&self, message: &Message) -> Result<lettre::Message, Failure> {
        // A mail client shows one mail for one id, and all mails of an alarm together.
        let domain = self.settings.from.email.domain();
        let mut mail = lettre::Message::builder()
            .from(self.settings.from.clone())
            .subject(message.subject())
            .message_id(Some(format!("<{}@{domain}>", message.id)));
        if message.what != What::Test {
            mail = mail.references(format!("<{}@{domain}>", message.alarm));
        }
        for to in &self.settings.to {
            mail = mail.to(to.clone());
        }
        mail.header(ContentType::TEXT_PLAIN)
            .body(message.text() + "\n")
            .map_err(|error| self.failed(error))
    }
}

impl Sink for Email {
    fn deliver(&mut self, message: &Message) -> Result<(), Failure> {
        let mail = self.mail(message)?;
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
