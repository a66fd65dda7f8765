//! Every case of the catalogue on the CPU, within its bounds; and that the runner sees what is out of them.

use planecast::stability::measure::{Truth, measure};
use planecast::stability::{Case, Drawer, Row, World, WorldName, cases};
use std::collections::HashMap;

/// All cases world by world, so that each world is made once.
fn by_world() -> Vec<(WorldName, Vec<Case>)> {
    let mut order: Vec<WorldName> = Vec::new();
    let mut sorted: HashMap<WorldName, Vec<Case>> = HashMap::new();
    for case in cases() {
        if !sorted.contains_key(&case.world) {
            order.push(case.world);
        }
        sorted.entry(case.world).or_default().push(case);
    }
    order.into_iter().map(|w| (w, sorted.remove(&w).unwrap())).collect()
}

fn line(row: &Row) -> String {
    format!(
        "{:62} {:10} off {:6.3} of {:5.1} cracks {} depth {:.1e} steps {:?} of {} moved {:?} ulps {:?}",
        row.case,
        row.device,
        row.off_percent,
        row.bound_off_percent,
        row.cracks,
        row.depth,
        row.steps,
        row.bound_steps,
        row.moved_percent,
        row.depth_ulps
    )
}

/// Runs every case on the devices that `drawers` gives for a world, and says what is out of its bounds.
fn run(drawers: impl Fn(&World) -> Vec<Drawer<'_>>) -> (Vec<Row>, Vec<String>) {
    let (mut rows, mut faults) = (Vec::new(), Vec::new());
    for (name, cases) in by_world() {
        let world = name.make();
        let mut drawers = drawers(&world);
        for case in &cases {
            let truth = Truth::new(case, &world).unwrap();
            for drawer in &mut drawers {
                let at = std::time::Instant::now();
                let row = measure(case, &world, &truth, drawer).unwrap();
                println!("{} {:.0?}", line(&row), at.elapsed());
                faults.extend(row.faults.iter().map(|f| format!("{}, {}: {f}", row.case, row.kernel)));
                rows.push(row);
            }
        }
    }
    (rows, faults)
}

#[test]
fn every_case_keeps_its_bounds_on_the_cpu() {
    let (_, faults) = run(|world| vec![Drawer::cpu(world), Drawer::exact(world)]);
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
}

#[cfg(feature = "gpu")]
#[test]
fn every_case_keeps_its_bounds_on_the_gpu() {
    if std::env::var_os("PLANECAST_NO_GPU").is_some_and(|v| v == "1") {
        eprintln!("skipped: PLANECAST_NO_GPU=1");
        return;
    }
    let (_, faults) = run(|world| planecast::Kernel::ALL.map(|k| Drawer::gpu(world, k, true).unwrap()).into());
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
}
