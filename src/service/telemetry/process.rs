//! Memory, descriptors, threads and processor time of this process, from `/proc`, under Prometheus' own names.

use super::collect::family;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::DescriptorEncoder;
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Unit;
use std::fmt;
use std::fs;

/// The process at the time of the scrape.
#[derive(Debug)]
pub(super) struct Process;

impl Collector for Process {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
        let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
        let stat = fs::read_to_string("/proc/self/stat").unwrap_or_default();
        let kilobytes = |field: &str| number_behind(&status, field).map(|kb| kb * 1024.0);
        let descriptors = fs::read_dir("/proc/self/fd")
            .ok()
            .map(|entries| entries.count().saturating_sub(1) as f64);
        let mut put = |name: &str, unit: Option<Unit>, help: &str, kind, value: Option<f64>| {
            let values = value.map(|value| (Vec::new(), value));
            family(&mut encoder, (name, unit, help), kind, values)
        };
        put(
            "process_resident_memory",
            Some(Unit::Bytes),
            "Memory in use",
            MetricType::Gauge,
            kilobytes("VmRSS:"),
        )?;
        put(
            "process_peak_memory",
            Some(Unit::Bytes),
            "The most memory ever in use",
            MetricType::Gauge,
            kilobytes("VmHWM:"),
        )?;
        put(
            "process_open_fds",
            None,
            "Open descriptors",
            MetricType::Gauge,
            descriptors,
        )?;
        put(
            "process_max_fds",
            None,
            "Most descriptors the system allows",
            MetricType::Gauge,
            number_behind(&limits, "Max open files"),
        )?;
        put(
            "process_threads",
            None,
            "Threads",
            MetricType::Gauge,
            number_behind(&status, "Threads:"),
        )?;
        put(
            "process_cpu",
            Some(Unit::Seconds),
            "Processor time used",
            MetricType::Counter,
            processor_s(&stat),
        )
    }
}

/// Name of the machine; empty if the system gives none.
pub fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    name.trim().to_owned()
}

/// The most memory that a process ever had \[MB\]; zero of one that has ended.
pub fn peak_mb(pid: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    number_behind(&status, "VmHWM:").unwrap_or(0.0) / 1024.0
}

/// Address space of this process \[bytes\].
pub fn address_space() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    number_behind(&status, "VmSize:").map(|kb| kb as u64 * 1024)
}

/// True if the system limits the address space of this process.
pub fn address_space_is_limited() -> bool {
    let limits = fs::read_to_string("/proc/self/limits").unwrap_or_default();
    number_behind(&limits, "Max address space").is_some()
}

/// Number after `field` at the begin of a line.
fn number_behind(text: &str, field: &str) -> Option<f64> {
    let rest = text.lines().find_map(|line| line.strip_prefix(field))?;
    rest.split_whitespace().next()?.parse().ok()
}

/// User and system time \[s\] from `/proc/self/stat`, the 14th and 15th field; the name before them may
/// contain blanks.
fn processor_s(stat: &str) -> Option<f64> {
    let (_, behind_name) = stat.rsplit_once(')')?;
    let mut fields = behind_name.split_whitespace().skip(11);
    let user: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some((user + system) / rustix::param::clock_ticks_per_second() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_found_whatever_the_program_is_called() {
        let stat = "7 (a) b) S 1 2 3 4 5 6 7 8 9 10 250 50 0 0 20";
        let ticks = rustix::param::clock_ticks_per_second() as f64;
        assert_eq!(processor_s(stat), Some(300.0 / ticks));
        assert_eq!(processor_s("broken"), None);
        assert_eq!(number_behind("VmRSS:\t  12 kB\n", "VmRSS:"), Some(12.0));
        assert_eq!(
            number_behind("Max open files            1024   4096 files", "Max open files"),
            Some(1024.0)
        );
        assert_eq!(number_behind("", "VmRSS:"), None);
    }
}
