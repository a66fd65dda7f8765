//! Every case of the catalogue on the CPU, within its bounds; and that the runner sees what is out of them.

use planecast::stability::measure::{Truth, measure};
use planecast::stability::{Case, Drawer, Row, WorldName, cases};
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

#[test]
fn every_case_keeps_its_bounds_on_the_cpu() {
    let mut faults = Vec::new();
    for (name, cases) in by_world() {
        let at = std::time::Instant::now();
        let world = name.make();
        eprintln!("{name:?} made {:?}", at.elapsed());
        let mut drawers = [Drawer::cpu(&world), Drawer::exact(&world)];
        for case in &cases {
            let at = std::time::Instant::now();
            let truth = Truth::new(case, &world).unwrap();
            let exact_at = at.elapsed();
            for drawer in &mut drawers {
                let row = measure(case, &world, &truth, drawer).unwrap();
                println!("{}", line(&row));
                faults.extend(row.faults.iter().map(|f| format!("{}, {}: {f}", row.case, row.device)));
            }
            if at.elapsed().as_millis() > 300 {
                eprintln!("slow: {} {exact_at:?} {:?}", case.name, at.elapsed());
            }
        }
    }
    assert!(faults.is_empty(), "{} faults\n{}", faults.len(), faults.join("\n"));
}
