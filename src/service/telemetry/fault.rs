//! Faults around a daemon that goes on: one name for log, health and metrics.

/// A kind of fault. Every occurrence is counted, shown and logged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Fault {
    /// A record gave no force, for a stated reason (kept in the store).
    Rejected,
    /// A recording is damaged, cut short, or cannot be read.
    Recording,
    /// A client sent malformed data, or broke the limits.
    Client,
    /// A client was turned away: too many, or not allowed.
    Refused,
    /// A client was silent for too long.
    Idle,
    /// An input or record that crashed the process repeatedly was set aside.
    Quarantined,
    /// The analysis of a record panicked.
    Broken,
    /// The disk has no room for results or the journal.
    DiskFull,
    /// The store was damaged when opened, and replaced by a new one.
    StoreDamaged,
    /// The store is new, but its journal filled another.
    StoreNew,
    /// The store or the journal cannot be written.
    Write,
    /// A sink cannot be reached, or refuses.
    Sink,
    /// The centre's post, or the bucket of the journal's copy, cannot be reached or refuses; at a centre: folding stands still, a site's
    /// messages are parked, or its alarms wait.
    Forward,
    /// Nothing is heard of a site at the centre.
    Silent,
    /// A command of the centre was refused, or waits for a person.
    Command,
    /// A new configuration has faults: the old one stays in force.
    Reload,
    /// A watched folder cannot be read.
    Folder,
    /// Messages come on a topic of no rod, while a rod gets none; or none of a rod's topic gives a sample.
    Topic,
    /// A sensor of a rod with several is left out of its records, or nothing comes of a rod's thermometer.
    LeftOut,
    /// Store or journal are no longer the files that are written, or can no longer be written.
    Files,
    /// The machine's clock jumped, or is in doubt.
    Clock,
    /// A certificate has ended or ends soon, or cannot be used.
    Certificate,
    /// Parts of the journal that may go wait for a backup, or for their copy to the bucket.
    Backup,
    /// Data come faster than they are analysed.
    Behind,
    /// No daemon worked for a while.
    Outage,
    /// The work loop is stalled.
    Stalled,
}

impl Fault {
    /// Every kind of fault.
    pub const ALL: [Self; 26] = [
        Self::Rejected,
        Self::Recording,
        Self::Client,
        Self::Refused,
        Self::Idle,
        Self::Quarantined,
        Self::Broken,
        Self::DiskFull,
        Self::StoreDamaged,
        Self::StoreNew,
        Self::Write,
        Self::Sink,
        Self::Forward,
        Self::Silent,
        Self::Command,
        Self::Reload,
        Self::Folder,
        Self::Topic,
        Self::LeftOut,
        Self::Files,
        Self::Clock,
        Self::Certificate,
        Self::Backup,
        Self::Behind,
        Self::Outage,
        Self::Stalled,
    ];

    /// Name in logs, health and metrics.
    pub fn code(self) -> &'static str {
        match self {
            Self::Rejected => "rejected",
            Self::Recording => "recording",
            Self::Client => "client",
            Self::Refused => "refused",
            Self::Idle => "idle",
            Self::Quarantined => "quarantined",
            Self::Broken => "broken",
            Self::DiskFull => "disk-full",
            Self::StoreDamaged => "store-damaged",
            Self::StoreNew => "store-new",
            Self::Write => "write",
            Self::Sink => "sink",
            Self::Forward => "forward",
            Self::Silent => "silent",
            Self::Command => "command",
            Self::Reload => "reload",
            Self::Folder => "folder",
            Self::Topic => "topic",
            Self::LeftOut => "left-out",
            Self::Files => "files",
            Self::Clock => "clock",
            Self::Certificate => "certificate",
            Self::Backup => "backup",
            Self::Behind => "behind",
            Self::Outage => "outage",
            Self::Stalled => "stalled",
        }
    }

    /// Meaning of the fault, in one sentence; docs/operations.md gives the remedy.
    pub fn meaning(self) -> &'static str {
        match self {
            Self::Rejected => "a record gave no force, for a reason that is kept in the store",
            Self::Recording => "a recording is damaged, cut short, or cannot be read",
            Self::Client => "a client sent what cannot be understood, or broke the limits",
            Self::Refused => "a client was turned away: too many, or not allowed",
            Self::Idle => "a client was silent for too long and was closed",
            Self::Quarantined => "something that again and again ended the program was set aside",
            Self::Broken => "the analysis of a record broke: a fault of the program",
            Self::DiskFull => "the disk has no room for results or the journal",
            Self::StoreDamaged => "the store was damaged when it was opened, and was begun anew",
            Self::StoreNew => {
                "the store is new, but its journal filled another: that one was lost, or the path is mistyped"
            }
            Self::Write => "the store or the journal cannot be written",
            Self::Sink => "a sink cannot be reached, or refuses: alarms wait",
            Self::Forward => {
                "the post to the centre, or the bucket, cannot be reached or refuses: results, or parts, wait here"
            }
            Self::Silent => "nothing is heard of a site (`tirante hub`)",
            Self::Command => "a command of the centre was refused, or waits for a person",
            Self::Reload => "a new configuration is bad: the old one holds",
            Self::Folder => "a watched folder cannot be read",
            Self::Topic => {
                "a topic comes that belongs to no rod, while nothing comes of a rod or of one of its sensors; or whose messages give no samples"
            }
            Self::LeftOut => {
                "a sensor of a rod with several is left out of its records, or nothing comes of a rod's thermometer"
            }
            Self::Files => "store or journal were removed, replaced, cut short or made read-only",
            Self::Clock => "the clock of the machine jumped, or is not believed",
            Self::Certificate => "a certificate has ended or ends soon, or cannot be used",
            Self::Backup => "old parts of the journal wait for a backup, or for their copy to the bucket",
            Self::Behind => "data come faster than they are analysed",
            Self::Outage => "no daemon was at work for a while: nothing was measured",
            Self::Stalled => "the work loop stands still",
        }
    }

    /// True if results are not kept, or not made, while it lasts.
    pub fn is_grave(self) -> bool {
        matches!(self, Self::DiskFull | Self::Write | Self::Files | Self::Stalled)
    }
}
