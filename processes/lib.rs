//! Sparrowhawk: the whole graph on one screen.
//!
//! ```text
//!  simulator | player                                         supervisor: starts, watches, restarts all
//!        │ stereo frames
//!        ▼
//!  stereo-ingest ──disparity──▶ expansion ──expanded──▶ memory ──keyframes──▶ planner ──trajectory──▶ controller
//!        ▲                                               ▲                      ▲                        │ setpoint
//!        └────────────── vehicle state, flight clock ────┴──────────────────────┴────────────────────────┘
//!  recorder: every topic → MCAP
//! ```
//!
//! [`build`](graph) turns a [`config::FlightConfig`] into processes; [`child`] runs one of them over iceoryx2,
//! [`lockstep`](graph::Flight) all of them in one thread. [`cli`] is the command line.

mod ablation;
mod calibrate;
mod campaign;
mod campaign_plot;
pub mod child;
pub mod cli;
pub mod config;
mod crash;
mod curves;
mod display;
mod draw;
mod evaluate;
mod expand;
mod fault_file;
mod fault_flight;
mod fault_plan;
mod fault_table;
mod faults;
mod flight_report;
mod flight_run;
mod fly;
pub mod graph;
pub mod graph_config;
mod ground_station;
mod inject;
mod log_compare;
mod log_files;
mod log_replay;
mod logging;
mod map;
mod noise_plot;
mod numbers;
mod picture;
pub mod posed_sequence;
mod recover;
mod refly;
mod replay;
mod replay_input;
mod replay_report;
mod report;
mod report_flight;
mod report_plots;
mod run_files;
mod run_record;
pub mod say;
mod soak;
mod status;
mod stereo;
mod svg;
mod trials;
mod troubles;
mod vehicle_config;
pub mod voxels;

pub use flight_report::report;
