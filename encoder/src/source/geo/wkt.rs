//! Reference systems as text (WKT 1 of OGC and of ESRI, WKT 2).

use super::{Crs, EARTH, Ellipsoid, Length, Model, Stretch, mercator_of};

/// Deepest nesting that is read; real texts have some eight levels.
const DEPTH: usize = 32;

/// `KEYWORD["text", number, NODE[…], …]`
#[derive(Debug, Default)]
struct Node {
    key: String,
    text: Vec<String>,
    numbers: Vec<f64>,
    nodes: Vec<Node>,
}

impl Node {
    fn name(&self) -> &str {
        self.text.first().map_or("", String::as_str)
    }

    fn child(&self, keys: &[&str]) -> Option<&Node> {
        self.nodes.iter().find(|n| keys.contains(&n.key.as_str()))
    }

    /// The first node of such a kind at any depth.
    fn find(&self, keys: &[&str]) -> Option<&Node> {
        self.child(keys).or_else(|| self.nodes.iter().find_map(|n| n.find(keys)))
    }

    /// The code that EPSG gives it.
    fn epsg(&self) -> Option<u16> {
        let id = self.child(&["AUTHORITY", "ID"])?;
        let is_epsg = id.name().eq_ignore_ascii_case("EPSG");
        let code = id.text.get(1).and_then(|t| t.trim().parse().ok()).or(id.numbers.first().map(|&n| n as u16));
        code.filter(|_| is_epsg)
    }

    /// Its unit: its own, or that of its first axis.
    fn unit(&self) -> Option<&Node> {
        const UNITS: &[&str] = &["UNIT", "LENGTHUNIT", "ANGLEUNIT"];
        let axis = || self.nodes.iter().filter(|n| n.key == "AXIS").find_map(|n| n.child(UNITS));
        self.child(UNITS).or_else(axis)
    }

    fn parameter(&self, names: &[&str]) -> Option<f64> {
        let plain = |n: &Node| n.name().to_lowercase().replace(['_', '-'], " ");
        let found = |n: &&Node| n.key == "PARAMETER" && names.contains(&plain(n).as_str());
        self.nodes.iter().find(found).and_then(|n| n.numbers.first().copied())
    }
}

impl Crs {
    /// A system from its text; None where that is none.
    pub fn of_wkt(text: &str) -> Option<Crs> {
        let mut reader = Reader { text: text.trim_start_matches('\u{feff}').trim(), nodes: 0 };
        let mut roots = Vec::new();
        // ESRI's texts may have one of the map and one of heights, with a comma between.
        while let Some(node) = reader.node(0) {
            roots.push(node);
            reader.text = reader.text.trim_start().trim_start_matches(',').trim_start();
        }
        let mut crs = of_node(roots.first()?, 0)?;
        if let Some(vertical) = roots.get(1).filter(|n| is_vertical(n)) {
            crs = with_vertical(crs, vertical);
        }
        Some(crs)
    }
}

fn is_vertical(node: &Node) -> bool {
    matches!(node.key.as_str(), "VERT_CS" | "VERTCS" | "VERTCRS" | "VERTICALCRS")
}

fn of_node(node: &Node, depth: usize) -> Option<Crs> {
    if depth > 4 {
        return None;
    }
    match node.key.as_str() {
        "COMPD_CS" | "COMPOUNDCRS" => {
            let parts = || node.nodes.iter();
            let map = parts().find(|n| !is_vertical(n) && of_node(n, depth + 1).is_some())?;
            let mut crs = of_node(map, depth + 1)?;
            if let Some(vertical) = parts().find(|n| is_vertical(n)) {
                crs = with_vertical(crs, vertical);
            }
            if let Some(code) = node.epsg() {
                crs.name = format!("EPSG:{code}");
            }
            Some(crs)
        }
        "BOUNDCRS" => node.child(&["SOURCECRS"]).and_then(|n| n.nodes.first()).and_then(|n| of_node(n, depth + 1)),
        "PROJCS" | "PROJCRS" | "PROJECTEDCRS" => Some(horizontal(node, Model::Projected)),
        "GEOGCS" | "GEOGCRS" | "GEOGRAPHICCRS" => Some(horizontal(node, Model::Geographic)),
        "GEODCRS" | "GEODETICCRS" => {
            let cartesian = node.child(&["CS"]).is_some_and(|n| n.name().eq_ignore_ascii_case("cartesian"));
            Some(horizontal(node, if cartesian { Model::Geocentric } else { Model::Geographic }))
        }
        "GEOCCS" => Some(horizontal(node, Model::Geocentric)),
        // A system of no body, such as a building site's: its unit is what it has.
        "LOCAL_CS" | "ENGCRS" | "ENGINEERINGCRS" => Some(horizontal(node, Model::Projected)),
        _ if is_vertical(node) => Some(with_vertical(Crs::default(), node)),
        _ => None,
    }
}

fn horizontal(node: &Node, model: Model) -> Crs {
    let mut crs = match node.epsg() {
        Some(code) => Crs::epsg(code, model),
        None => {
            Crs { name: node.name().chars().filter(|c| !c.is_control()).take(80).collect(), model, ..Crs::default() }
        }
    };
    let size = |n: &Node| n.numbers.first().copied().filter(|v| *v > 0.0 && v.is_finite());
    match node.unit().and_then(|n| size(n).map(|size| (n.name(), size))) {
        Some((_, radians)) if model == Model::Geographic => {
            crs.unit = radians.to_degrees();
            // Texts round π / 180 in many ways.
            if (crs.unit - 1.0).abs() < 1e-6 {
                crs.unit = 1.0;
            }
            crs.unit_name = if crs.unit == 1.0 { "degrees".to_owned() } else { format!("× {} degrees", crs.unit) };
        }
        Some((name, metres)) => {
            if let Some(unit) = Length::of_metres(metres, name) {
                (crs.unit, crs.unit_name) = (unit.metres, unit.name);
            }
        }
        None if crs.unit_name.is_empty() => {
            crs.unit_name = if model == Model::Geographic { "degrees" } else { "m" }.to_owned();
        }
        None => {}
    }
    if let Some(&[a, inverse, ..]) = node.find(&["SPHEROID", "ELLIPSOID"]).map(|n| n.numbers.as_slice())
        && a > 0.0
        && a.is_finite()
    {
        let e2 = if inverse > 1.0 { (2.0 - 1.0 / inverse) / inverse } else { 0.0 };
        crs.body = Ellipsoid { a, e2 };
    }
    if crs.stretch == Stretch::None && model == Model::Projected {
        crs.stretch = stretch(node, crs.unit, crs.body);
    }
    crs
}

/// What the projection of a map without a code that is known stretches.
fn stretch(node: &Node, unit: f64, body: Ellipsoid) -> Stretch {
    // Of version 1 in the node itself, of version 2 in its conversion.
    let of = node.child(&["CONVERSION"]).unwrap_or(node);
    let Some(method) = of.child(&["PROJECTION", "METHOD"]) else { return Stretch::None };
    let method = method.name().to_lowercase().replace(['_', '-'], " ");
    let north = of.parameter(&["false northing", "northing at false origin"]).unwrap_or(0.0) * unit;
    let parallel = of.parameter(&["standard parallel 1", "latitude of 1st standard parallel"]);
    let scale = of.parameter(&["scale factor", "scale factor at natural origin"]).filter(|k| *k > 0.0);
    let web = node.find(&["EXTENSION"]).is_some_and(|n| n.text.iter().any(|t| t.contains("+nadgrids=@null")));
    match method.as_str() {
        "popular visualisation pseudo mercator" | "mercator auxiliary sphere" => {
            Stretch::Mercator { k0: 1.0, north, sphere: true }
        }
        "mercator"
        | "mercator 1sp"
        | "mercator 2sp"
        | "mercator (variant a)"
        | "mercator (variant b)"
        | "mercator (1sp)"
        | "mercator (2sp)"
        | "mercator (spherical)" => match (scale, parallel) {
            (_, Some(parallel)) if body == EARTH || parallel != 0.0 => mercator_of(parallel, north),
            (k0, _) => Stretch::Mercator { k0: k0.unwrap_or(1.0), north, sphere: web || body.e2 == 0.0 },
        },
        "equirectangular" | "equidistant cylindrical" | "equidistant cylindrical (spherical)" | "plate carree" => {
            Stretch::Equidistant { parallel: parallel.unwrap_or(0.0), north }
        }
        _ => Stretch::None,
    }
}

fn with_vertical(mut crs: Crs, node: &Node) -> Crs {
    if let Some(code) = node.epsg() {
        crs = crs.with_vertical(code);
    }
    if let Some(unit) = node.unit()
        && let Some(unit) = unit.numbers.first().and_then(|&metres| Length::of_metres(metres, unit.name()))
    {
        crs.up = Some(unit);
    }
    let axis = node.child(&["AXIS"]).is_some_and(|n| n.text.iter().any(|t| t.eq_ignore_ascii_case("down")));
    crs.down |= axis || node.parameter(&["direction"]).is_some_and(|d| d < 0.0);
    crs
}

struct Reader<'a> {
    text: &'a str,
    nodes: usize,
}

impl Reader<'_> {
    fn node(&mut self, depth: usize) -> Option<Node> {
        self.nodes += 1;
        let open = self.text.find(['[', '('])?;
        let key = self.text[..open].trim();
        if depth > DEPTH
            || self.nodes > 4096
            || key.is_empty()
            || !key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        {
            return None;
        }
        let mut node = Node { key: key.to_ascii_uppercase(), ..Node::default() };
        self.text = &self.text[open + 1..];
        loop {
            self.text = self.text.trim_start();
            let end = self.text.find([',', ']', ')', '[', '(']);
            if let Some(rest) = self.text.strip_prefix('"') {
                let close = rest.find('"')?;
                node.text.push(rest[..close].to_owned());
                self.text = &rest[close + 1..];
                // A quote within a text is doubled.
                while let Some(more) = self.text.strip_prefix('"') {
                    let close = more.find('"')?;
                    let last = node.text.last_mut().expect("just pushed");
                    last.push('"');
                    last.push_str(&more[..close]);
                    self.text = &more[close + 1..];
                }
            } else if self.text[end?..].starts_with(['[', '(']) {
                node.nodes.push(self.node(depth + 1)?);
            } else {
                let word = self.text[..end?].trim();
                match word.parse::<f64>() {
                    Ok(number) => node.numbers.push(number),
                    Err(_) if word.is_empty() => {}
                    Err(_) => node.text.push(word.to_owned()),
                }
                self.text = &self.text[end?..];
            }
            self.text = self.text.trim_start();
            let mut rest = self.text.chars();
            match rest.next()? {
                ',' => self.text = rest.as_str(),
                ']' | ')' => {
                    self.text = rest.as_str();
                    return Some(node);
                }
                _ => return None,
            }
        }
    }
}
