//! Memory that was freed goes back to the system.
//!
//! The allocator of the GNU C library keeps what a thread has freed in an arena of that thread. A daemon whose
//! threads take turns at a long record would hold the largest of their needs several times over, for months.

/// Arenas of the whole process.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const ARENAS: libc::c_int = 2;
/// Size from which a block is mapped on its own, and unmapped when freed \[B\].
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAPPED: libc::c_int = 1 << 20;

/// Asks for it. Called before threads start: an arena that exists stays.
pub fn return_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: `mallopt` takes two integers and locks the allocator itself.
    unsafe {
        libc::mallopt(libc::M_ARENA_MAX, ARENAS);
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED);
    }
}
