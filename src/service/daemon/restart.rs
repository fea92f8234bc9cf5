//! Settings that a reload cannot change.

use crate::config::Config;

/// Keys that differ and take effect only after a restart.
pub fn needed_for(old: &Config, new: &Config) -> Vec<&'static str> {
    let (ingest, other) = (&old.ingest, &new.ingest);
    let changed = [
        ("[store] path", old.store.path != new.store.path),
        (
            "[ingest] folder, subfolders",
            (&ingest.folder, ingest.subfolders) != (&other.folder, other.subfolders),
        ),
        ("[ingest] listen", ingest.listen != other.listen),
        ("[ingest.tls]", ingest.tls != other.tls),
        (
            "[ingest] settle_s, join_s, clients, idle_s, resume_h",
            (
                ingest.settle_s,
                ingest.join_s,
                ingest.clients,
                ingest.idle_s,
                ingest.resume_s,
            ) != (
                other.settle_s,
                other.join_s,
                other.clients,
                other.idle_s,
                other.resume_s,
            ),
        ),
        ("[journal]", old.journal != new.journal),
        ("[bucket]", old.bucket != new.bucket),
        ("[http]", old.http != new.http),
    ];
    changed
        .into_iter()
        .filter_map(|(key, differs)| differs.then_some(key))
        .collect()
}
