//! `[bucket]`: the copy of the journal's parts to object storage.

use super::list::file;
use super::range::toml_string;
use super::reader::{Absent, Table, key};
use super::value::Value;
use crate::config::settings::bucket::BucketSettings;
use std::net::IpAddr;

/// Region that servers of one's own take.
const REGION: &str = "us-east-1";

/// Server, bucket and prefix of an address.
struct Place {
    server: String,
    bucket: String,
    prefix: String,
}

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> Option<BucketSettings> {
    let place = table.take(
        key(
            "to",
            "server, bucket and the beginning of the objects' names: https://s3.example.org/monuments/todi",
        ),
        "an address with a bucket, without user and password; http:// on this machine only",
        Absent::Required,
        place,
        |place| toml_string(&[place.server.as_str(), &place.bucket, &place.prefix].join("/")),
    );
    let region = table.take(
        key("region", "region that the requests are signed for"),
        "1 to 64 letters, digits, '-'",
        Absent::Default(REGION.to_owned()),
        |value| {
            let text = value.name_string()?;
            let is_region = text.len() <= 64
                && text
                    .bytes()
                    .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-');
            if !is_region {
                value.fault(format!("\"{text}\" is no region, write it like eu-south-1"));
            }
            is_region.then(|| text.to_owned())
        },
        |region| toml_string(region),
    );
    let credentials = file(
        table,
        key(
            "credentials",
            "file with two lines, access key id and secret access key, readable by its owner alone; may begin with $CREDENTIALS_DIRECTORY/",
        ),
        "required",
    );
    if credentials.is_none() {
        table.absence_of("credentials", "file with access key id and secret access key");
    }
    let is_tls = place
        .as_ref()
        .is_none_or(|place| place.server.starts_with("https://"));
    let ca = file(
        table,
        key(
            "ca",
            "file with the certificates (PEM) that are trusted instead of the built-in roots",
        )
        .only(is_tls, "https://"),
        "the built-in roots are trusted",
    );
    let place = place?;
    Some(BucketSettings {
        server: place.server,
        bucket: place.bucket,
        prefix: place.prefix,
        region: region?,
        credentials: credentials?,
        ca,
    })
}

fn place(value: &Value<'_>) -> Option<Place> {
    let text = value.name_string()?;
    let refuse = |why: &str| {
        value.fault(format!("{text} {why}"));
        None
    };
    let Some((scheme, rest)) = text
        .split_once("://")
        .filter(|(scheme, _)| ["http", "https"].contains(scheme))
    else {
        return refuse("is no address: write https://s3.example.org/bucket");
    };
    let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
    if host.contains('@') || text.contains(['?', '#']) {
        return refuse("holds more than server, bucket and name: keys go into the file `credentials`");
    }
    let (bucket, prefix) = path.split_once('/').unwrap_or((path, ""));
    let is_bucket = (3..=63).contains(&bucket.len())
        && bucket
            .bytes()
            .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b".-".contains(&byte));
    if host.is_empty() || !is_bucket {
        return refuse("names no bucket behind the server: 3 to 63 small letters, digits, '.', '-'");
    }
    let prefix = prefix.trim_end_matches('/');
    let is_word = |word: &str| {
        !word.is_empty()
            && word != "."
            && word != ".."
            && word
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"._-".contains(&byte))
    };
    if !prefix.is_empty() && !prefix.split('/').all(is_word) {
        return refuse("has other signs than letters, digits, '.', '_', '-' behind the bucket");
    }
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    let is_here = name == "localhost" || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback());
    if scheme == "http" && !is_here {
        return refuse("is another machine: only https:// goes there");
    }
    Some(Place {
        server: format!("{scheme}://{host}"),
        bucket: bucket.to_owned(),
        prefix: prefix.to_owned(),
    })
}
