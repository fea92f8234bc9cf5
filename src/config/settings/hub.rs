//! Settings of the centre: its storage and its sites.

use super::credential::CredentialPath;
use std::path::PathBuf;

/// Storage of the centre.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Storage {
    /// A file, for up to some 200 rods.
    Sqlite(PathBuf),
    /// A PostgreSQL server.
    Postgres(PostgresSettings),
}

/// Connection to a PostgreSQL server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PostgresSettings {
    /// Connection string of libpq, without a password.
    pub connection: String,
    /// File with the password.
    pub password_file: Option<CredentialPath>,
    /// File with the certificates (PEM) that its server's must come from; TLS is used with it alone.
    pub ca: Option<CredentialPath>,
}

/// Copies of the rows of sites whose pages are looked at.
#[derive(Debug, Clone, PartialEq)]
pub struct CopiesSettings {
    /// Folder for them.
    pub path: PathBuf,
    /// Age of the oldest records in them \[s\].
    pub shown_s: f64,
}

/// A site on the list.
#[derive(Debug, Clone, PartialEq)]
pub struct SiteSettings {
    /// Name, as in its subjects.
    pub name: String,
    /// Address of its own page, shown as a link.
    pub link: Option<String>,
    /// Latitude and longitude, WGS 84 \[degrees\].
    pub position: Option<[f64; 2]>,
    /// Time without a message or sign of life after which it counts as silent \[s\].
    pub silent_s: f64,
    /// File with the seed that signs commands to it.
    pub command_key: Option<CredentialPath>,
    /// Configuration of a site without a computer, which a worker monitors.
    pub config: Option<PathBuf>,
}
