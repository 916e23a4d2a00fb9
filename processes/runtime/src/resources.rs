//! What a process may use of the machine: processors, priority, memory. Each is asked of the kernel, and where it refuses,
//! the process flies without and says so.

use ipc_types::bounds::Bounds;
use rustix::mm::{MlockAllFlags, mlockall};
use rustix::process::{Resource, Rlimit, setpriority_process, setrlimit};
use rustix::thread::{CpuSet, sched_setaffinity};
use serde::{Deserialize, Serialize};

/// Resources of one process.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Resources {
    /// Processors that it may run on; empty for all.
    pub cpus: Vec<u32>,
    /// Real-time priority (SCHED_FIFO), 1..50; 0 for none.
    pub realtime: u8,
    /// How far others go before it where they want the same processor (nice), 0..19.
    pub nice: u8,
    /// Whether its memory stays in memory.
    pub lock_memory: bool,
    /// Most private memory, MiB; 0 for no limit. What asks for more is refused it, and dies and is restarted.
    pub memory_mib: u64,
}

impl Resources {
    /// Reports values out of range.
    pub fn check(&self, bounds: &mut Bounds) {
        self.cpus.iter().for_each(|&cpu| bounds.range("cpus", cpu, 0..=1023));
        bounds.range("realtime", self.realtime, 0..=50);
        bounds.range("nice", self.nice, 0..=19);
        let is_sane = self.memory_mib == 0 || (64..=1 << 20).contains(&self.memory_mib);
        bounds.require(
            is_sane,
            "memory_mib",
            format_args!("is {}, allowed is 0 for no limit, or 64 to {}", self.memory_mib, 1 << 20),
        );
    }

    /// Asks for them, for this process and the threads that it starts from now on. Returns what was refused, for people.
    pub fn apply(&self) -> Vec<String> {
        let mut refused = Vec::new();
        let mut note = |what: String, result: Result<(), String>, instead: &str| {
            if let Err(why) = result {
                refused.push(format!("{what}: {why}; {instead}"));
            }
        };
        if !self.cpus.is_empty() {
            let mut set = CpuSet::new();
            self.cpus.iter().filter(|&&cpu| (cpu as usize) < CpuSet::MAX_CPU).for_each(|&cpu| set.set(cpu as usize));
            let result = sched_setaffinity(None, &set).map_err(|errno| errno.to_string());
            note(format!("processors {:?}", self.cpus), result, "running on all of them");
        }
        if self.realtime > 0 {
            let result = set_realtime(self.realtime);
            let instead = "running at normal priority (needs CAP_SYS_NICE, or LimitRTPRIO= in the unit)";
            note(format!("real-time priority {}", self.realtime), result, instead);
        }
        if self.nice > 0 {
            // Of the calling thread, and of those that it starts.
            let result = setpriority_process(None, i32::from(self.nice)).map_err(|errno| errno.to_string());
            note(format!("niceness {}", self.nice), result, "running at normal priority");
        }
        if self.memory_mib > 0 {
            let most = Some(self.memory_mib << 20);
            let result = setrlimit(Resource::Data, Rlimit { current: most, maximum: most });
            note(
                format!("memory limit of {} MiB", self.memory_mib),
                result.map_err(|e| e.to_string()),
                "without a limit",
            );
        }
        if self.lock_memory {
            // On fault: shared-memory segments are large and mostly never touched.
            let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
            let result = mlockall(flags).map_err(|errno| errno.to_string());
            note("locked memory".to_owned(), result, "memory may be swapped out (needs LimitMEMLOCK=infinity)");
        }
        refused
    }
}

fn set_realtime(priority: u8) -> Result<(), String> {
    let parameter = libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: the parameter outlives the call, which only reads it; 0 is the calling process.
    let result = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameter) };
    if result == 0 { Ok(()) } else { Err(std::io::Error::last_os_error().to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_had_is_said_and_what_can_be_is_not() {
        let nothing = Resources { cpus: Vec::new(), realtime: 0, nice: 0, lock_memory: false, memory_mib: 0 };
        assert!(nothing.apply().is_empty());
        // In a thread, whose affinity is its own.
        let absent = std::thread::spawn(|| {
            let absent = Resources { cpus: vec![1000], realtime: 0, nice: 0, lock_memory: false, memory_mib: 0 };
            absent.apply()
        });
        let refused = absent.join().expect("no panic");
        assert!(refused.len() == 1 && refused[0].contains("running on all of them"), "{refused:?}");
        let first = std::thread::spawn(|| {
            let first = Resources { cpus: vec![0], realtime: 0, nice: 0, lock_memory: false, memory_mib: 0 };
            (first.apply(), rustix::thread::sched_getaffinity(None).map(|set| set.count()))
        });
        assert_eq!(first.join().expect("no panic"), (Vec::new(), Ok(1)));
        let mut bounds = Bounds::default();
        Resources { cpus: vec![5000], realtime: 99, nice: 20, lock_memory: false, memory_mib: 3 }.check(&mut bounds);
        assert_eq!(bounds.into_violations().len(), 4);
    }
}
