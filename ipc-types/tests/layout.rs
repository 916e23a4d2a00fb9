//! The layout of every wire type is on record: a change of any offset, type or name fails here.

use ipc_types::for_each_topic;
use ipc_types::topics::*;
use ipc_types::wire::{Stamp, Wire};

#[test]
fn wire_layouts_match_the_snapshot() {
    let mut found = vec![Stamp::layout()];
    macro_rules! describe {
        ($($topic:ident),*) => {$(
            found.push(format!(
                "topic {} schema {:016x}\n{}\nelements: {}",
                $topic::INFO.name,
                ($topic::INFO.schema_hash)(),
                <$topic as Topic>::Header::layout(),
                <$topic as Topic>::Element::layout()
            ));
        )*};
    }
    for_each_topic!(describe);
    let found = found.join("\n\n") + "\n";
    let snapshot = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/layout.snapshot");
    let recorded = std::fs::read_to_string(snapshot).unwrap_or_default();
    if found != recorded {
        let fresh = std::env::temp_dir().join("sparrowhawk-layout.snapshot");
        std::fs::write(&fresh, &found).expect("temporary folder is writable");
        panic!(
            "wire layouts differ from {snapshot}; if the change is meant, raise the versions of the types that \
             changed and copy {} over it",
            fresh.display()
        );
    }
}
