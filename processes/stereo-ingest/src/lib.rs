//! stereo-ingest
