//! `densecloud serve` as a process, with the model inside it and clients from elsewhere.

mod addresses;
mod batch;
mod clean;
mod command;
mod completions;
mod defaults;
mod doors;
mod faults;
mod hostile;
mod kills;
mod log;
mod many;
mod meanings;
mod mesh;
mod outputs;
mod regions;
mod remote;
mod report;
mod results;
mod settings;
mod signals;
mod support;
mod tiles;
mod view;
