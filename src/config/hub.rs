//! Configuration of `tirante hub`: post, storage, page, and the list of sites.

use super::list::file;
use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use super::settings::alert::{AlertSettings, SinkSettings};
use super::settings::forward::NatsSettings;
use super::settings::http::HttpSettings;
use super::settings::hub::{CopiesSettings, PostgresSettings, SiteSettings, Storage};
use super::value::toml_floats;
use super::{ConfigError, forward, http, parse_tables, read_text, sink};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const HOUR_S: f64 = 3600.0;
const DAY_S: f64 = 24.0 * HOUR_S;
/// Most sites of one hub.
const MOST_SITES: usize = 10_000;

/// Configuration of the centre.
#[derive(Debug, Clone, PartialEq)]
pub struct HubConfig {
    /// Post.
    pub nats: NatsSettings,
    /// Addresses of the servers' monitoring, where their flushing to disk is looked up.
    pub monitors: Vec<String>,
    /// True if missing streams are created.
    pub is_creating: bool,
    /// Storage of the results.
    pub storage: Storage,
    /// Page, health and metrics.
    pub http: HttpSettings,
    /// Sites whose messages are taken, in the order of their names.
    pub sites: Vec<SiteSettings>,
    /// Destinations of what the hub has to say of itself and its sites.
    pub sinks: Vec<SinkSettings>,
    /// Settings of these messages.
    pub alert: AlertSettings,
    /// File that keeps what is told to the sinks; present with sinks.
    pub outbox: Option<PathBuf>,
    /// Copies of the rows of sites whose pages are looked at.
    pub copies: CopiesSettings,
}

impl HubConfig {
    /// Reads and validates a file.
    ///
    /// # Errors
    /// The file cannot be read, or its faults, all of them.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::parse(&read_text(path)?, &path.display().to_string())
    }

    /// Reads and validates a text called `origin` in messages.
    ///
    /// # Errors
    /// Its faults, all of them, in the order of the text.
    pub fn parse(text: &str, origin: &str) -> Result<Self, ConfigError> {
        let (config, _) = parse_tables(text, origin, &[], "config/fleet/hub.toml", Self::read)?;
        Ok(config)
    }

    fn read(root: &mut Table<'_>) -> Option<Self> {
        let (nats, monitors, is_creating) = root.section("nats", "The post.", |table| {
            let nats = forward::nats(table, "to");
            let monitors = table.take(
                key(
                    "monitor",
                    "address of the server's monitoring (http_port), where the hub looks up that each message is flushed; those of a cluster separated by commas",
                ),
                "http://host:port",
                Absent::Nothing("the hub cannot see whether each message is flushed, and says so"),
                |value| {
                    let texts = value.name_string()?.split(',').map(str::trim);
                    let mut monitors = Vec::new();
                    for text in texts {
                        if !text.starts_with("http://") && !text.starts_with("https://") {
                            value.fault(format!("{text} is no address, write it like http://127.0.0.1:8222"));
                            return None;
                        }
                        monitors.push(text.trim_end_matches('/').to_owned());
                    }
                    Some(monitors)
                },
                |monitors: &Vec<String>| toml_string(&monitors.join(",")),
            );
            let is_creating = table.take(
                key("create", "whether missing streams are created"),
                "true or false",
                Absent::Default(true),
                |value| value.boolean(),
                bool::to_string,
            );
            (nats, monitors.unwrap_or_default(), is_creating.unwrap_or(true))
        });
        let sqlite = root.optional_section("sqlite", "A file as storage, up to some 200 rods.", |table| {
            table.take(
                key("path", "the database file; relative to the working folder"),
                "1 to 255 bytes of text",
                Absent::Required,
                |value| value.name_string().map(PathBuf::from),
                |path| toml_string(&path.display().to_string()),
            )
        });
        let postgres = root.optional_section("postgres", "A PostgreSQL server as storage.", postgres);
        let storage = match (sqlite, postgres) {
            (Some(path), None) => path.map(Storage::Sqlite),
            (None, Some(settings)) => settings.map(Storage::Postgres),
            (Some(_), Some(_)) => {
                root.fault_of("sqlite", "stands beside [postgres]: results have one storage");
                None
            }
            (None, None) => {
                root.absence_of("sqlite", "[sqlite] or [postgres], where results are kept");
                None
            }
        };
        let http = root.section("http", "Page, health and metrics.", http::read);
        let mut names = BTreeSet::new();
        let meaning = "A site whose messages are taken.";
        let mut sites = root.list_of(MOST_SITES, "site", meaning, |table| {
            let site = site(table)?;
            if !names.insert(site.name.clone()) {
                table.fault_of("name", format!("\"{}\" stands twice", site.name));
            }
            Some(site)
        });
        sites.sort_by(|one, other| {
            let names = [one, other].map(|site| site.as_ref().map(|site| &site.name));
            names[0].cmp(&names[1])
        });
        let has_thin = sites.iter().flatten().any(|site| site.config.is_some());
        if has_thin && matches!(storage, Some(Storage::Sqlite(_))) {
            root.fault_of(
                "sqlite",
                "cannot hold the leases of [[site]]s with `config`: name a [postgres] server",
            );
        }
        if sites.is_empty() {
            root.absence_of(
                "site",
                "at least one [[site]]: the messages of no other are taken",
            );
        }
        let sinks = sink::read_all(root, sink::Whose::Centre(&names));
        let alert = root.section(
            "alert",
            "How the sinks are told of the hub and its sites.",
            |table| sink::heartbeat::read(table, sinks.as_deref()),
        );
        let outbox = root.optional_section(
            "outbox",
            "What is told to the sinks; needed beside [[sink]].",
            |table| {
                table.take(
                    key("path", "a file of the hub's own; relative to the working folder"),
                    "1 to 255 bytes of text",
                    Absent::Required,
                    |value| value.name_string().map(PathBuf::from),
                    |path| toml_string(&path.display().to_string()),
                )
            },
        );
        if outbox.is_none() && sinks.as_ref().is_some_and(|sinks| !sinks.is_empty()) {
            root.absence_of(
                "outbox",
                "[outbox] with the path of a file for what is told to the sinks",
            );
        }
        let (copies, shown_s) = root.section(
            "copies",
            "Copies of the rows of sites whose pages are looked at.",
            copies,
        );
        let storage = storage?;
        let outbox = match outbox {
            Some(outbox) => Some(outbox?),
            None => None,
        };
        let own_file = match (&outbox, &storage) {
            (Some(path), _) | (None, Storage::Sqlite(path)) => path.as_path(),
            (None, Storage::Postgres(_)) => Path::new(""),
        };
        let copies = CopiesSettings {
            path: copies.unwrap_or_else(|| own_file.with_file_name("copies")),
            shown_s,
        };
        Some(Self {
            copies,
            sinks: sinks?,
            alert,
            outbox,
            nats: nats?,
            monitors,
            is_creating,
            storage,
            http,
            sites: sites.into_iter().collect::<Option<Vec<_>>>()?,
        })
    }

    /// The site called `name`.
    pub fn site(&self, name: &str) -> Option<&SiteSettings> {
        let place = self.sites.binary_search_by(|site| site.name.as_str().cmp(name));
        self.sites.get(place.ok()?)
    }

    /// True for a site without a computer, which workers write.
    pub fn is_thin(&self, name: &str) -> bool {
        self.site(name).is_some_and(|site| site.config.is_some())
    }
}

fn copies(table: &mut Table<'_>) -> (Option<PathBuf>, f64) {
    let path = table.take(
        key("path", "folder for them; relative to the working folder"),
        "1 to 255 bytes of text",
        Absent::Nothing("`copies` beside the outbox or the SQLite file, else in the working folder"),
        |value| value.name_string().map(PathBuf::from),
        |path| toml_string(&path.display().to_string()),
    );
    let days = table.number(
        key(
            "days",
            "age of the oldest records that the page of a site shows [d]",
        ),
        Range::within(1.0, 36_500.0),
        400.0,
    );
    (path, DAY_S * days)
}

fn postgres(table: &mut Table<'_>) -> Option<PostgresSettings> {
    let connection = table.take(
        key(
            "connection",
            "host, port, user and database, as `host=db.example user=tirante dbname=tirante`; without a password",
        ),
        "1 to 255 bytes of text",
        Absent::Required,
        |value| {
            let text = value.name_string()?;
            match text.parse::<postgres::Config>() {
                Ok(config) if config.get_password().is_some() => {
                    value.fault("a secret does not belong into the configuration: name a `password_file`");
                    None
                }
                Ok(_) => Some(text.to_owned()),
                Err(error) => {
                    value.fault(format!("is no connection string: {error}"));
                    None
                }
            }
        },
        |text| toml_string(text),
    );
    let password_file = file(
        table,
        key("password_file", "file with the password of the user"),
        "no password is sent",
    );
    let ca = file(
        table,
        key(
            "ca",
            "file with the certificates (PEM) that the server's must come from; needed for another machine",
        ),
        "not encrypted: on this machine only",
    );
    let connection = connection?;
    let is_here = |host: &postgres::config::Host| match host {
        postgres::config::Host::Tcp(name) => {
            name == "localhost"
                || name
                    .parse::<std::net::IpAddr>()
                    .is_ok_and(|address| address.is_loopback())
        }
        postgres::config::Host::Unix(_) => true,
    };
    let parsed: Option<postgres::Config> = connection.parse().ok();
    // `hostaddr` is where the connection goes, whatever `host` says; without both there is no place.
    let is_all_here = |config: &postgres::Config| {
        let (hosts, addresses) = (config.get_hosts(), config.get_hostaddrs());
        !(hosts.is_empty() && addresses.is_empty())
            && hosts.iter().all(is_here)
            && addresses.iter().all(std::net::IpAddr::is_loopback)
    };
    if ca.is_none() && !parsed.as_ref().is_some_and(is_all_here) {
        table.fault_of(
            "connection",
            "is another machine: name the certificates of its authority as `ca`",
        );
    }
    Some(PostgresSettings {
        connection,
        password_file,
        ca,
    })
}

fn site(table: &mut Table<'_>) -> Option<SiteSettings> {
    let name = table.take(
        key("name", "name of the site, as its [forward] says"),
        "1 to 64 letters, digits, '-', '_'",
        Absent::Required,
        forward::site,
        |name| toml_string(name),
    );
    let link = table.take(
        key("link", "address of the site's own page, shown as a link"),
        "http://… or https://…",
        Absent::Nothing("no link"),
        |value| {
            let text = value.name_string()?;
            if !text.starts_with("http://") && !text.starts_with("https://") {
                value.fault(format!("{text} is no address of a page"));
                return None;
            }
            Some(text.to_owned())
        },
        |text| toml_string(text),
    );
    let position = table.take(
        key(
            "position",
            "latitude and longitude, WGS 84, where the map shows it [degrees]",
        ),
        "[latitude, longitude]: -90 to 90, and -180 to 180",
        Absent::Nothing("it is not on the map"),
        |value| {
            let list = value.numbers(Range::within(-180.0, 180.0), 2, 2)?;
            let [latitude, longitude] = list[..] else {
                return None;
            };
            if latitude.abs() > 90.0 {
                value.fault(format!(
                    "{latitude} is no latitude: it comes first, from -90 to 90"
                ));
                return None;
            }
            Some([latitude, longitude])
        },
        |position| toml_floats(position),
    );
    let silent_s = HOUR_S
        * table.number(
            key(
                "silent_h",
                "a site of which nothing came for this long counts as silent [h]",
            ),
            Range::within(0.001, 8760.0),
            1.0,
        );
    let command_key = file(
        table,
        key(
            "command_key",
            "file with the seed that signs commands to this site (`hub key --commands`), readable by its owner alone",
        ),
        "no command can be given to it",
    );
    let config = table.take(
        key(
            "config",
            "configuration of a site without a computer, which `tirante work` monitors; relative to the working folder",
        ),
        "1 to 255 bytes of text",
        Absent::Nothing("a daemon at the site monitors it"),
        |value| value.name_string().map(PathBuf::from),
        |path| toml_string(&path.display().to_string()),
    );
    Some(SiteSettings {
        command_key,
        config,
        name: name?,
        link,
        position,
        silent_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEAST: &str = "[nats]\nto = \"nats://127.0.0.1\"\n[[site]]\nname = \"todi\"\n";

    #[test]
    fn the_example_is_taken_with_and_without_its_sink() {
        let example = include_str!("../../config/fleet/hub.toml");
        assert!(HubConfig::parse(example, "hub.toml").unwrap().sinks.is_empty());
        let with_sink: Vec<&str> = example
            .lines()
            .map(|line| {
                line.strip_prefix('#')
                    .filter(|rest| !rest.starts_with(' '))
                    .unwrap_or(line)
            })
            .collect();
        let config = HubConfig::parse(&with_sink.join("\n"), "hub.toml").unwrap();
        assert_eq!((config.sinks.len(), config.outbox.is_some()), (1, true));
        assert!(config.sites[0].position.is_some());
    }

    #[test]
    fn thousands_of_sites_are_found_by_name_in_any_order() {
        let of = |count: usize| {
            let names = (0..count)
                .rev()
                .map(|number| format!("[[site]]\nname = \"s{number}\"\n"));
            let text = format!("{LEAST}{}[sqlite]\npath = \"c.db\"\n", names.collect::<String>());
            HubConfig::parse(&text, "hub.toml")
        };
        let config = of(MOST_SITES - 1).unwrap();
        for name in ["todi", "s0", "s42", "s9998"] {
            assert_eq!(config.site(name).unwrap().name, name);
        }
        assert_eq!(config.site("s9999"), None);
        let refused = of(MOST_SITES).unwrap_err().to_string();
        assert!(
            refused.contains("stands 10001 times, at most 10000 are allowed"),
            "{refused}"
        );
    }

    #[test]
    fn copies_are_beside_the_hubs_own_files_unless_a_folder_is_named() {
        let of = |more: &str| {
            let config = HubConfig::parse(&format!("{LEAST}{more}"), "hub.toml").unwrap();
            (config.copies.path.display().to_string(), config.copies.shown_s)
        };
        let postgres = "[postgres]\nconnection = \"host=127.0.0.1\"\n";
        let outbox = "[outbox]\npath = \"own/outbox.db\"\n";
        for (more, path) in [
            (
                "[sqlite]\npath = \"state/centre.db\"\n".to_owned(),
                "state/copies",
            ),
            (postgres.to_owned(), "copies"),
            (format!("{postgres}{outbox}"), "own/copies"),
            (
                format!("{postgres}{outbox}[copies]\npath = \"/var/cache/t\"\n"),
                "/var/cache/t",
            ),
        ] {
            assert_eq!(of(&more), (path.to_owned(), 400.0 * DAY_S), "{more}");
        }
        assert_eq!(of(&format!("{postgres}[copies]\ndays = 10\n")).1, 10.0 * DAY_S);
        let wrong = HubConfig::parse(&format!("{LEAST}{postgres}[copies]\ndays = 0\n"), "hub.toml");
        assert!(wrong.unwrap_err().to_string().contains("copies.days"));
    }
}
