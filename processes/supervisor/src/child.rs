//! One child as the operating system has it: started or adopted, watched by its pidfd, signalled, reaped.
//!
//! A pidfd names this very process and no later one of the same number. It also tells of the death of a child that another
//! supervisor started, which nobody here could `waitpid` for.

use procfs::process::Process as Proc;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd, OwnedFd};
use rustix::process::{
    Pid, PidfdFlags, Signal, WaitOptions, kill_process_group, pidfd_open, pidfd_send_signal, waitpgid,
};
use serde::{Deserialize, Serialize};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::Duration;

/// What the kernel says of a process that does not beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Look {
    /// Stopped by a signal or a debugger.
    Halted,
    /// It has waited for the processor most of the time since it was last looked at.
    Starved,
    /// Neither.
    Awake,
}

/// What a process uses of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Usage {
    /// Share of one processor, over the last second or so.
    pub cpu: f64,
    /// Resident memory, bytes.
    pub resident_bytes: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

/// A process that was started or adopted, and has not been reaped.
#[derive(Debug)]
pub(crate) struct Running {
    pid: Pid,
    pidfd: OwnedFd,
    /// Absent for the adopted.
    child: Option<Child>,
    /// Processor time that it had used when it was last looked at, ticks.
    used_ticks: u64,
    /// The same, when its usage was last asked for.
    sampled_ticks: u64,
}

impl Running {
    /// Starts a program, in a process group of its own: Ctrl-C reaches the supervisor alone, which stops the others in order.
    pub(crate) fn start(arguments: &[String]) -> io::Result<Self> {
        let (program, rest) = arguments.split_first().ok_or(io::ErrorKind::InvalidInput)?;
        let mut child =
            Command::new(program).args(rest).stdin(Stdio::null()).stdout(Stdio::null()).process_group(0).spawn()?;
        let watched = pid(child.id()).and_then(|pid| Ok((pid, pidfd_open(pid, PidfdFlags::empty())?)));
        match watched {
            Ok((pid, pidfd)) => {
                let used_ticks = ticks(pid).unwrap_or_default();
                Ok(Self { pid, pidfd, child: Some(child), used_ticks, sampled_ticks: used_ticks })
            }
            // Out of descriptors: a child that cannot be watched must not live. The wait ends, for it was killed.
            Err(error) => {
                let _ = child.kill();
                let _ = child.wait();
                Err(error)
            }
        }
    }

    /// Takes over a process that a former supervisor started. It is that one for as long as it holds its claim on the run.
    pub(crate) fn adopt(number: u32) -> Option<Self> {
        let pid = pid(number).ok()?;
        let pidfd = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        let used_ticks = ticks(pid)?;
        let running = Self { pid, pidfd, child: None, used_ticks, sampled_ticks: used_ticks };
        (!running.has_ended()).then_some(running)
    }

    pub(crate) fn number(&self) -> u32 {
        self.pid.as_raw_nonzero().get().unsigned_abs()
    }

    /// Sends a signal. What has just died needs none any more; its exit is on the way.
    pub(crate) fn signal(&self, signal: Signal) {
        let _ = pidfd_send_signal(&self.pidfd, signal);
    }

    pub(crate) fn has_ended(&self) -> bool {
        wait_any([self], Duration::ZERO)
    }

    /// How it ended, if it did. What it forked goes with it.
    pub(crate) fn reap(&mut self) -> Option<String> {
        if !self.has_ended() {
            return None;
        }
        Some(match &mut self.child {
            Some(child) => {
                // Before it is reaped: until then the group's number is its own.
                let _ = kill_process_group(self.pid, Signal::KILL);
                describe(&child.wait())
            }
            None => "ended under another supervisor, which alone could have learned how".to_owned(),
        })
    }

    /// What the kernel says of it, and of what it did since the last look, `elapsed` ago.
    pub(crate) fn look(&mut self, elapsed: Duration) -> Look {
        let Ok(stat) = Proc::new(self.pid.as_raw_nonzero().get()).and_then(|process| process.stat()) else {
            return Look::Awake;
        };
        let used = stat.utime + stat.stime;
        let used_s = seconds(used.saturating_sub(std::mem::replace(&mut self.used_ticks, used)));
        match stat.state {
            'T' | 't' => Look::Halted,
            'R' if used_s < 0.3 * elapsed.as_secs_f64() => Look::Starved,
            _ => Look::Awake,
        }
    }

    /// What it has used since it was last asked, `elapsed` ago.
    pub(crate) fn usage(&mut self, elapsed: Duration) -> Option<Usage> {
        let process = Proc::new(self.pid.as_raw_nonzero().get()).ok()?;
        Usage::of(&process, &mut self.sampled_ticks, elapsed)
    }
}

impl Usage {
    /// What a process uses. `sampled_ticks`: processor time that it had used `elapsed` ago; brought up to date.
    fn of(process: &Proc, sampled_ticks: &mut u64, elapsed: Duration) -> Option<Self> {
        let stat = process.stat().ok()?;
        let used = stat.utime + stat.stime;
        let since = used.saturating_sub(std::mem::replace(sampled_ticks, used));
        Some(Self {
            cpu: seconds(since) / elapsed.as_secs_f64().max(1e-3),
            resident_bytes: stat.rss * rustix::param::page_size() as u64,
            descriptors: process.fd_count().unwrap_or_default() as u64,
        })
    }

    /// What this process itself uses.
    pub fn own(sampled_ticks: &mut u64, elapsed: Duration) -> Option<Self> {
        Self::of(&Proc::myself().ok()?, sampled_ticks, elapsed)
    }
}

/// Waits until one of them has ended, or the time has passed; whether one has.
pub(crate) fn wait_any<'a>(children: impl IntoIterator<Item = &'a Running>, patience: Duration) -> bool {
    let mut fds: Vec<_> =
        children.into_iter().map(|child| PollFd::from_borrowed_fd(child.pidfd.as_fd(), PollFlags::IN)).collect();
    let timeout = Timespec { tv_sec: patience.as_secs().min(3600) as i64, tv_nsec: i64::from(patience.subsec_nanos()) };
    // An interrupted wait is one that ended early.
    matches!(poll(&mut fds, Some(&timeout)), Ok(ready) if ready > 0)
}

/// Reaps what a dead child has left to this process, its subreaper; whether any of it is still ending.
pub(crate) fn reap_group(number: u32) -> bool {
    let Ok(pid) = pid(number) else { return false };
    loop {
        match waitpgid(pid, WaitOptions::NOHANG) {
            Ok(Some(_)) => {}
            Ok(None) => return true,
            Err(_) => return false,
        }
    }
}

fn pid(number: u32) -> io::Result<Pid> {
    i32::try_from(number).ok().and_then(Pid::from_raw).ok_or_else(|| io::ErrorKind::InvalidInput.into())
}

/// Processor time, of the kernel's ticks, s.
fn seconds(ticks: u64) -> f64 {
    ticks as f64 / procfs::ticks_per_second() as f64
}

/// How much processor time a process has used, ticks.
fn ticks(pid: Pid) -> Option<u64> {
    let stat = Proc::new(pid.as_raw_nonzero().get()).ok()?.stat().ok()?;
    Some(stat.utime + stat.stime)
}

fn describe(status: &io::Result<ExitStatus>) -> String {
    match status {
        Ok(status) => match (status.code(), status.signal()) {
            (Some(code), _) => format!("exited with status {code}"),
            (None, Some(signal)) => format!("was killed by signal {signal}"),
            (None, None) => "ended".to_owned(),
        },
        Err(error) => format!("could not be waited for: {error}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Running {
        Running::start(&["/bin/sh".to_owned(), "-c".to_owned(), script.to_owned()]).expect("a shell")
    }

    fn end_of(mut running: Running) -> String {
        assert!(wait_any([&running], Duration::from_secs(20)), "it does not end");
        running.reap().expect("ended")
    }

    #[test]
    fn the_end_of_a_child_is_told_with_its_status() {
        assert_eq!(end_of(shell("exit 3")), "exited with status 3");
        let sleeper = shell("exec sleep 60");
        assert!(!sleeper.has_ended());
        sleeper.signal(Signal::KILL);
        assert_eq!(end_of(sleeper), "was killed by signal 9");
    }

    #[test]
    fn what_a_child_forked_goes_with_it() {
        rustix::process::set_child_subreaper(Some(rustix::process::getpid())).expect("permitted");
        let parent = shell("sleep 60 & echo; kill -9 $$");
        let group = parent.number();
        end_of(parent);
        let began = std::time::Instant::now();
        while reap_group(group) {
            assert!(began.elapsed() < Duration::from_secs(10), "its child lives on");
        }
    }

    #[test]
    fn a_stopped_child_is_seen_and_an_adopted_one_is_watched_to_its_end() {
        let mut sleeper = shell("exec sleep 60");
        sleeper.signal(Signal::STOP);
        let began = std::time::Instant::now();
        while sleeper.look(Duration::ZERO) != Look::Halted {
            assert!(began.elapsed() < Duration::from_secs(10));
        }
        let adopted = Running::adopt(sleeper.number()).expect("alive");
        adopted.signal(Signal::KILL);
        assert!(wait_any([&adopted], Duration::from_secs(20)));
        let number = sleeper.number();
        end_of(sleeper);
        assert!(Running::adopt(number).is_none(), "nobody is there any more");
    }
}
