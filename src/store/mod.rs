//! What is remembered: SQLite in WAL mode, one transaction per record.
