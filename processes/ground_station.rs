//! `sparrowhawk ground`: vehicles seen and commanded from the ground, as a page, as text, or as lines for scripts.

use crate::config::FlightConfig;
use crate::numbers::parse_numbers;
use crate::say::say;
use bridge::{TlsConfig, keys};
use clap::Args;
use ground::{Asked, Operator, OperatorError, VehicleView, Watch};
use std::collections::HashSet;
use std::error::Error;
use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Between two lines, or two tables.
const INTERVAL: Duration = Duration::from_millis(500);
/// A vehicle that is to be asked for something is waited for so long.
const PATIENCE: Duration = Duration::from_secs(10);

/// What to watch, and how.
#[derive(Debug, Args)]
pub(crate) struct GroundArguments {
    /// Connect to a vehicle, or to a router: tcp/127.0.0.1:7447, or tls/ADDRESS:PORT with --tls.
    #[arg(long, value_name = "ENDPOINT", default_value = "tcp/127.0.0.1:7447")]
    connect: Vec<String>,
    /// Let vehicles connect to here instead.
    #[arg(long, value_name = "ENDPOINT", conflicts_with = "connect")]
    listen: Vec<String>,
    /// Certificates (PEM): of the authority, one's own, its key.
    #[arg(long, value_name = "FILE", num_args = 3)]
    tls: Option<Vec<PathBuf>>,
    /// Where the page is served. Beyond this machine it is only to look at.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8080")]
    page: SocketAddr,
    /// What this operator is called: as in the certificate, or like this machine, if not given; no two at a time may be called the
    /// same, and by another name than the certificate's nothing is commanded.
    #[arg(long, value_name = "NAME")]
    operator: Option<String>,
    /// A table in the terminal, instead of the page.
    #[arg(long, conflicts_with_all = ["json", "order"])]
    text: bool,
    /// Lines of JSON, instead of the page: one for every vehicle, twice a second.
    #[arg(long, conflicts_with = "order")]
    json: bool,
    /// Ask a vehicle for this, say what became of it, and end: take, route, speed, hover, resume, land, return, clear-map.
    #[arg(long)]
    order: Option<String>,
    /// Whom; needed where there are several.
    #[arg(long, value_name = "NAME", requires = "order")]
    vehicle: Option<String>,
    /// For a route: a place, x,y,z, m. Repeat for more.
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_numbers::<3>, allow_hyphen_values = true, requires = "order")]
    to: Vec<[f64; 3]>,
    /// For a route or a speed: the highest speed, m/s.
    #[arg(long, value_name = "M/S", requires = "order", default_value_t = 0.0)]
    speed: f64,
    /// For so long an order may be followed, s.
    #[arg(long, value_name = "S", requires = "order", default_value_t = 2.0)]
    valid: f64,
}

impl GroundArguments {
    fn tls(&self) -> Option<TlsConfig> {
        let files = self.tls.as_deref()?;
        let [authority, certificate, key] = files else { return None };
        Some(TlsConfig { authority: authority.clone(), certificate: certificate.clone(), key: key.clone() })
    }

    /// The one in the certificate; without one, who sits at one machine is one operator.
    fn operator(&self) -> Result<String, Box<dyn Error>> {
        let host = || {
            let name = rustix::system::uname().nodename().to_string_lossy().into_owned();
            let may = |letter: char| if letter.is_ascii_alphanumeric() { letter } else { '-' };
            name.chars().map(may).take(32).collect()
        };
        let certified = self.tls().map(|tls| tls.own_name()).transpose()?;
        let name = self.operator.clone().or(certified).unwrap_or_else(host);
        let expected = "expected 1 to 32 letters, digits, - or _: give --operator, or a certificate with such a name";
        keys::is_name(&name).then_some(()).ok_or_else(|| format!("the operator is \"{name}\", {expected}"))?;
        Ok(name)
    }
}

pub(crate) fn ground(arguments: &GroundArguments) -> Result<ExitCode, Box<dyn Error>> {
    let stop = Arc::new(AtomicBool::new(false));
    crate::cli::stop_on_signals(&stop)?;
    // Who only looks needs no name.
    let looks = arguments.text || arguments.json;
    let operator = if looks { String::new() } else { arguments.operator()? };
    let connect = if arguments.listen.is_empty() { &arguments.connect[..] } else { &[] };
    say(format_args!("looking for vehicles at {:?}", connect.iter().chain(&arguments.listen).collect::<Vec<_>>()));
    let patience = arguments.order.as_ref().map_or(Duration::MAX, |_| PATIENCE);
    let watch = joined(connect, &arguments.listen, arguments.tls(), &stop, patience)?;
    let Some(watch) = watch else { return Ok(ExitCode::SUCCESS) };
    let operator = Operator::new(watch.clone(), &operator);
    if let Some(order) = &arguments.order {
        return ask(arguments, order, &watch, &operator);
    }
    if !arguments.text && !arguments.json {
        let (address, watched) = (arguments.page, watch.clone());
        std::thread::spawn(move || {
            let ready = |address| say(format_args!("the page is http://{address}/"));
            if let Err(error) = ground::serve(address, watched, operator, ready) {
                say(format_args!("error: {error}"));
                std::process::exit(2);
            }
        });
    }
    let learning = watch.clone();
    std::thread::spawn(move || learn(&learning));
    while !stop.load(Ordering::Relaxed) {
        let views = watch.views();
        // Whoever read this may have gone: then there is nobody left to tell.
        let told = match (arguments.json, arguments.text) {
            (true, _) => views.iter().try_for_each(|view| write_line(&serde_json::to_string(view).unwrap_or_default())),
            (_, true) => write_line(&format!("\x1b[H\x1b[2J{}", table(&views)?)),
            _ => Ok(()),
        };
        if told.is_err() {
            break;
        }
        std::thread::sleep(INTERVAL);
    }
    // Not closed in order: a peer that does not answer would be waited for.
    std::process::exit(0);
}

/// Joins the network; in the meantime it can be interrupted. `None` if it was.
fn joined(
    connect: &[String],
    listen: &[String],
    tls: Option<TlsConfig>,
    stop: &Arc<AtomicBool>,
    patience: Duration,
) -> Result<Option<Watch>, Box<dyn Error>> {
    let begun = Instant::now();
    let (connect, listen) = (connect.to_vec(), listen.to_vec());
    let joining = std::thread::spawn(move || Watch::begin(&connect, &listen, tls.as_ref()));
    while !joining.is_finished() {
        if stop.load(Ordering::Relaxed) {
            return Ok(None);
        }
        if begun.elapsed() > patience {
            return Err(format!("nobody answered for {} s", patience.as_secs()).into());
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    let watch = joining.join().map_err(|_| "joining the network failed")??;
    Ok(Some(watch))
}

fn write_line(text: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush())
}

/// Asks vehicles that are new for where their cameras are. Of those that do not answer it asks again.
fn learn(watch: &Watch) {
    let mut known = HashSet::new();
    loop {
        for VehicleView { name, .. } in watch.views().iter().filter(|view| view.connected && view.flight_s > 0.0) {
            if known.contains(name) {
                continue;
            }
            let config = watch.ask(name, keys::CONFIG).and_then(|config| String::from_utf8(config).ok());
            if let Some(Ok(config)) = config.map(|config| FlightConfig::parse_snapshot(name, &config)) {
                watch.set_mount(name, config.vehicle.mount);
                known.insert(name.clone());
            }
        }
        std::thread::sleep(INTERVAL);
    }
}

fn ask(
    arguments: &GroundArguments,
    order: &str,
    watch: &Watch,
    operator: &Operator,
) -> Result<ExitCode, Box<dyn Error>> {
    let begun = Instant::now();
    let vehicle = loop {
        // Without a state its time is not known, and no order can be dated.
        let views: Vec<_> = watch.views().into_iter().filter(|view| view.flight_s > 0.0).collect();
        match (&arguments.vehicle, &views[..]) {
            (Some(name), views) if views.iter().any(|view| view.name == *name) => break name.clone(),
            (None, [only]) => break only.name.clone(),
            (None, [_, _, ..]) => {
                let names: Vec<_> = views.iter().map(|view| view.name.as_str()).collect();
                return Err(format!("there are {}: say which with --vehicle", names.join(", ")).into());
            }
            _ if begun.elapsed() > PATIENCE => {
                return Err(format!("no vehicle was heard for {} s", PATIENCE.as_secs()).into());
            }
            _ => std::thread::sleep(Duration::from_millis(50)),
        }
    };
    let order = order.to_owned();
    let (places_m, speed_mps, valid_s) = (arguments.to.clone(), arguments.speed, arguments.valid);
    let asked = Asked { vehicle, order, places_m, speed_mps, valid_s };
    let code = match operator.ask(&asked) {
        Ok(()) => {
            write_line(&format!("{}: {}: accepted", asked.vehicle, asked.order))?;
            0
        }
        Err(error @ (OperatorError::Rejected(_) | OperatorError::NoAnswer)) => {
            write_line(&format!("{}: {}: {error}", asked.vehicle, asked.order))?;
            1
        }
        Err(error) => return Err(error.into()),
    };
    std::process::exit(code);
}

fn table(views: &[VehicleView]) -> Result<String, std::fmt::Error> {
    use std::fmt::Write as _;
    let mut out = String::new();
    if views.is_empty() {
        out.push_str("no vehicle heard yet\n");
    }
    for view in views {
        let at = view.position_m.map_or_else(|| "–".to_owned(), |[x, y, z]| format!("{x:.1}, {y:.1}, {z:.1} m"));
        let link = if view.connected { "heard" } else { "NOT HEARD" };
        writeln!(out, "{}  {link} {:.1} s ago  {:.0} kbit/s", view.name, view.age_s, view.kbit_s)?;
        writeln!(
            out,
            "flight {:.1} s  {}  at {at}  {:.1} m/s  ladder: {} {}",
            view.flight_s, view.mode, view.speed_mps, view.rung, view.rung_reason
        )?;
        let mission = &view.mission;
        let (passed, places) = (mission["passed"].as_u64(), mission["elements"].as_array().map(Vec::len));
        if let (Some(passed), Some(places)) = (passed, places) {
            let commander = mission["commander"].as_str().filter(|name| !name.is_empty()).unwrap_or("nobody");
            let limit_mps = mission["speed_mps"].as_f64().unwrap_or_default() * view.speed_share;
            writeln!(
                out,
                "mission: {passed} of {places} places passed, at most {limit_mps:.1} m/s; commander: {commander}; exposure to command {:.0} ms",
                view.latency_ms
            )?;
        }
        for alarm in &view.alarms {
            writeln!(out, "  !! {alarm}")?;
        }
        writeln!(out, "  {:<14}{:>8} {:<9}{:>9}{:>8}{:>10}", "process", "PID", "state", "restarts", "beat", "step")?;
        for p in &view.processes {
            writeln!(
                out,
                "  {:<14}{:>8} {:<9}{:>9}{:>6.1} s{:>7.1} ms  {}",
                p.name, p.pid, p.level, p.restarts, p.age_s, p.step_ms, p.note
            )?;
        }
        out.push('\n');
    }
    Ok(out)
}
