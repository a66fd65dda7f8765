//! Empty: its dependencies are what it is for.
