//! The expansion process: disparity topic in, expanded topic out.

use crate::{Config, Expander, Reach};
use ipc_types::noise::NoiseModel;
use ipc_types::time::FlightTime;
use ipc_types::topics::{Disparity, Expanded};
use ipc_types::{ProcessId, StereoRig};
use runtime::{Connect, Message, Ports, Process, Report};

/// Connects an [`Expander`] to its topics.
#[derive(Debug)]
pub struct ExpansionProcess {
    expander: Expander,
    pixels: usize,
    radius_m: f32,
    report: Report,
}

impl ExpansionProcess {
    /// For a rig's images from a sensor that reaches so near.
    pub fn new(rig: StereoRig, noise: &NoiseModel, reach: Reach, config: Config) -> Self {
        Self {
            expander: Expander::new(rig, noise, reach, config),
            pixels: rig.pixels(),
            radius_m: config.radius_m,
            report: Report::waiting("waiting for disparity images"),
        }
    }
}

impl Process for ExpansionProcess {
    const ID: ProcessId = ProcessId::Expansion;

    fn connect(&self, connect: &mut impl Connect) {
        connect.reads::<Disparity>();
        connect.writes::<Expanded>();
    }

    fn step<P: Ports>(&mut self, ports: &mut P) -> Report {
        let Some(image) = ports.latest::<Disparity>() else {
            return self.report.idle();
        };
        let header = *image.header();
        let valid = FlightTime::from_nanos(header.stamp.valid_ns);
        if image.elements().len() != self.pixels {
            return self.report.refuse("disparity image is not of the rig's size");
        }
        let (layout, radius_m) = (self.expander.layout(), self.radius_m);
        let expander = &mut self.expander;
        ports.publish::<Expanded>(valid, layout.elements(), |out, elements| {
            // The size was checked above, so this cannot fail; were it to, nothing would be vouched for.
            let unknown_share = match expander.step(image.elements(), elements) {
                Ok(expansion) => expansion.unknown_share,
                Err(_) => {
                    elements.fill(0);
                    1.0
                }
            };
            (out.width_px, out.height_px) = (layout.width_px, layout.height_px);
            (out.margin_px, out.layers) = (layout.margin_px, layout.layers.count());
            out.radius_m = radius_m;
            out.unknown_share = unknown_share;
        });
        self.report.worked()
    }
}
