//! How long a process lives on without a supervisor.
//!
//! A dead supervisor's children fly on for the lease. Whoever takes the run over meanwhile writes its number to the run's
//! folder, and is their supervisor from then on.

use crate::ports::host_now;
use crate::run_dir::RunDir;
use ipc_types::HostTime;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd, OwnedFd};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use std::time::Duration;

/// A process' lease on its supervisor's life.
#[derive(Debug)]
pub(super) struct Lease {
    run: RunDir,
    supervisor: u32,
    pidfd: Option<OwnedFd>,
    length: Duration,
    orphaned_since: Option<HostTime>,
}

impl Lease {
    pub(super) fn new(run: &RunDir, supervisor: u32, length: Duration) -> Self {
        Self { run: run.clone(), supervisor, pidfd: watch(supervisor), length, orphaned_since: None }
    }

    /// Whether the supervisor died before this process had begun, and is not the one that the run names any more: whoever
    /// has taken the run since starts its own.
    pub(super) fn is_replaced(&self) -> bool {
        let is_dead = !self.pidfd.as_ref().is_some_and(is_alive);
        is_dead && self.run.supervisor() != Some(self.supervisor)
    }

    /// Whether the supervisor has been dead for longer than the lease, and nobody has taken its place.
    pub(super) fn is_over(&mut self) -> bool {
        if self.pidfd.as_ref().is_some_and(is_alive) {
            return false;
        }
        let now = host_now();
        let since = *self.orphaned_since.get_or_insert(now);
        if let Some(successor) = self.run.supervisor().filter(|&number| number != self.supervisor) {
            let pidfd = watch(successor).filter(is_alive);
            if pidfd.is_some() {
                (self.supervisor, self.pidfd, self.orphaned_since) = (successor, pidfd, None);
                return false;
            }
        }
        now.saturating_since(since) > self.length
    }
}

fn watch(number: u32) -> Option<OwnedFd> {
    let pid = i32::try_from(number).ok().and_then(Pid::from_raw)?;
    pidfd_open(pid, PidfdFlags::empty()).ok()
}

/// A pidfd is readable once its process has ended.
fn is_alive(pidfd: &OwnedFd) -> bool {
    let mut fds = [PollFd::from_borrowed_fd(pidfd.as_fd(), PollFlags::IN)];
    !matches!(poll(&mut fds, Some(&Timespec { tv_sec: 0, tv_nsec: 0 })), Ok(ready) if ready > 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Child, Command};

    fn sleeper() -> Child {
        Command::new("sleep").arg("60").spawn().expect("a process")
    }

    fn end(mut child: Child) {
        child.kill().expect("killed");
        child.wait().expect("reaped");
    }

    #[test]
    fn the_lease_runs_from_the_supervisors_death_and_ends_with_a_successor() {
        let run = RunDir::named(&format!("lease-{}", std::process::id())).expect("a good name");
        let _lock = run.take().expect("free");
        let (first, second) = (sleeper(), sleeper());
        run.name_supervisor(first.id()).expect("writable");
        let mut lease = Lease::new(&run, first.id(), Duration::from_secs(3600));
        let mut short = Lease::new(&run, first.id(), Duration::ZERO);
        assert!(!lease.is_over() && lease.orphaned_since.is_none());
        end(first);
        assert!(!lease.is_over() && lease.orphaned_since.is_some(), "it has only just begun");
        let began = std::time::Instant::now();
        while !short.is_over() {
            assert!(began.elapsed() < Duration::from_secs(10), "it never ends");
        }
        assert!(!lease.is_replaced());
        run.name_supervisor(second.id()).expect("writable");
        assert!(lease.is_replaced(), "and a process that starts only now is not wanted");
        assert!(!lease.is_over() && lease.orphaned_since.is_none(), "adopted");
        end(second);
        assert!(!lease.is_over() && lease.orphaned_since.is_some());
    }
}
