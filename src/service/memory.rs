//! Memory that was freed goes back to the system.
//!
//! The allocator of the GNU C library keeps what a thread has freed in an arena of that thread. A daemon whose
//! threads take turns at a long record would hold the largest of their needs several times over, for months.

/// Asks for it, but for what the environment says. Called before threads start: an arena that exists stays.
pub fn return_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (variable, parameter, value) in [
        // Arenas of the whole process.
        ("MALLOC_ARENA_MAX", libc::M_ARENA_MAX, 2),
        // Size from which a block is mapped on its own, and unmapped when freed [B].
        ("MALLOC_MMAP_THRESHOLD_", libc::M_MMAP_THRESHOLD, 1 << 20),
    ] {
        if std::env::var_os(variable).is_none() {
            // SAFETY: `mallopt` takes two integers and locks the allocator itself.
            unsafe { libc::mallopt(parameter, value) };
        }
    }
}
