//! Fitted emulators on disk, under the hash of what they depend on; a damaged or stale file is refitted.
