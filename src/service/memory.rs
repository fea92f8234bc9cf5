//! Memory that was freed goes back to the system.
//!
//! The allocator of the GNU C library keeps what a thread has freed in an arena of that thread. A daemon whose
//! threads take turns at a long record would hold the largest of their needs several times over, for months.

/// Asks for it where memory is freed, but for what the environment says. Called before threads start: an arena that exists stays.
pub fn return_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (variable, parameter, value) in [
        // Arenas of the whole process.
        ("MALLOC_ARENA_MAX", libc::M_ARENA_MAX, 2),
        // Size from which a block is mapped on its own, and unmapped when freed [B].
        ("MALLOC_MMAP_THRESHOLD_", libc::M_MMAP_THRESHOLD, 128 << 10),
    ] {
        if std::env::var_os(variable).is_none() {
            // SAFETY: `mallopt` takes two integers and locks the allocator itself.
            unsafe { libc::mallopt(parameter, value) };
        }
    }
}

/// Gives back what lies free between blocks in use, in every arena: working memory of the largest records so far would stay else.
pub fn trim() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `malloc_trim` takes an integer and locks the allocator itself.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    #![allow(clippy::unwrap_used)]

    fn resident_mib() -> u64 {
        let pages = std::fs::read_to_string("/proc/self/statm").unwrap();
        let pages: u64 = pages.split_whitespace().nth(1).unwrap().parse().unwrap();
        (pages * rustix::param::page_size() as u64) >> 20
    }

    #[test]
    fn what_lies_free_between_blocks_in_use_goes_back() {
        // 256 MiB, of which a block in 64 stays: the tests beside this one need far less.
        let mut blocks: Vec<Vec<u8>> = (0..1 << 16).map(|_| vec![1; 4096]).collect();
        let mut number = 0;
        blocks.retain(|_| {
            number += 1;
            number % 64 == 0
        });
        let before = resident_mib();
        super::trim();
        let after = resident_mib();
        assert!(after + 128 < before, "{before} MiB before, {after} MiB after");
        assert_eq!(blocks.len(), 1 << 10);
    }
}
