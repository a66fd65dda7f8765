//! One self-contained HTML page: text, tables, plots and pictures, no scripts and nothing fetched.
//!
//! Everything is put on the page in the order of the calls. Texts are plain and escaped here.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fmt::Write;

/// A page under construction.
#[derive(Clone, Debug)]
pub struct Page {
    title: String,
    body: String,
}

/// A table: numbers are set to the right, everything else to the left.
#[derive(Clone, Debug, Default)]
pub struct Table {
    pub caption: String,
    pub head: Vec<String>,
    pub rows: Vec<Row>,
}

/// One row of a table.
#[derive(Clone, Debug, Default)]
pub struct Row {
    pub cells: Vec<String>,
    /// How the row is told apart from the others.
    pub mark: Mark,
}

/// What a row's figures are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mark {
    /// Measured here.
    #[default]
    Plain,
    /// Measured here, and to be seen first.
    Strong,
    /// Taken from elsewhere; the source belongs in a cell or in the caption.
    Quoted,
}

impl Row {
    pub fn new<S: Into<String>>(cells: impl IntoIterator<Item = S>) -> Row {
        Row::marked(Mark::Plain, cells)
    }

    pub fn marked<S: Into<String>>(mark: Mark, cells: impl IntoIterator<Item = S>) -> Row {
        Row { cells: cells.into_iter().map(Into::into).collect(), mark }
    }
}

impl Table {
    /// The same in Markdown; the caption comes first.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = if self.caption.is_empty() { String::new() } else { format!("{}\n\n", self.caption) };
        text += &line(&self.head);
        text += &format!("|{}\n", "---|".repeat(self.head.len()));
        self.rows.iter().for_each(|row| match row.mark {
            Mark::Strong => text += &line(&row.cells.iter().map(|cell| format!("**{cell}**")).collect::<Vec<_>>()),
            Mark::Plain | Mark::Quoted => text += &line(&row.cells),
        });
        text
    }
}

const STYLE: &str = "\
body{font:15px/1.5 system-ui,sans-serif;color:#1c2430;background:#fff;max-width:1080px;margin:2em auto;padding:0 1em}
h1{font-size:1.6em}h2{font-size:1.25em;margin-top:2em;border-bottom:1px solid #d8dee6}h3{font-size:1.05em}
table{border-collapse:collapse;margin:1em 0;font-size:.88em;display:block;overflow-x:auto}
caption{text-align:left;color:#566;padding-bottom:.3em}
th,td{padding:.2em .6em;border-bottom:1px solid #e4e8ee;text-align:left;white-space:nowrap}
th{background:#f4f6f9}td.n{text-align:right;font-variant-numeric:tabular-nums}
tr.strong td{background:#e9f6ec;font-weight:600}tr.quoted td{background:#f6f2e8;color:#654;font-style:italic}
figure{margin:1em 0}figcaption{color:#566;font-size:.9em}figure svg,figure img{max-width:100%;height:auto}
.side{display:flex;gap:8px;flex-wrap:wrap}.side figure{flex:1 1 30%;margin:0}
.side img{width:100%;max-width:480px;image-rendering:pixelated}
pre{background:#f4f6f9;padding:.6em;overflow-x:auto}";

impl Page {
    pub fn new(title: &str) -> Page {
        Page { title: title.into(), body: format!("<h1>{}</h1>\n", escape(title)) }
    }

    /// A heading of rank 2 (a section) or 3 (within one).
    pub fn heading(&mut self, rank: u8, text: &str) {
        self.add(format_args!("<h{rank}>{}</h{rank}>\n", escape(text)));
    }

    pub fn paragraph(&mut self, text: &str) {
        self.add(format_args!("<p>{}</p>\n", escape(text)));
    }

    /// Text as typed into or printed by a terminal.
    pub fn code(&mut self, text: &str) {
        self.add(format_args!("<pre>{}</pre>\n", escape(text)));
    }

    pub fn list<S: AsRef<str>>(&mut self, items: impl IntoIterator<Item = S>) {
        self.body += "<ul>\n";
        for item in items {
            self.add(format_args!("<li>{}</li>\n", escape(item.as_ref())));
        }
        self.body += "</ul>\n";
    }

    pub fn table(&mut self, table: &Table) {
        self.body += "<table>";
        if !table.caption.is_empty() {
            self.add(format_args!("<caption>{}</caption>", escape(&table.caption)));
        }
        self.body += "<thead><tr>";
        for cell in &table.head {
            self.add(format_args!("<th>{}</th>", escape(cell)));
        }
        self.body += "</tr></thead><tbody>\n";
        for row in &table.rows {
            self.body += match row.mark {
                Mark::Plain => "<tr>",
                Mark::Strong => "<tr class=\"strong\">",
                Mark::Quoted => "<tr class=\"quoted\">",
            };
            for cell in &row.cells {
                let class = if is_number(cell) { " class=\"n\"" } else { "" };
                self.add(format_args!("<td{class}>{}</td>", escape(cell)));
            }
            self.body += "</tr>\n";
        }
        self.body += "</tbody></table>\n";
    }

    /// A plot; `svg` is put into the page as it is.
    pub fn svg(&mut self, svg: &str, caption: &str) {
        // A declaration may stand only at the start of a file.
        let svg = svg.find("<svg").map_or(svg, |at| &svg[at..]);
        self.add(format_args!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", escape(caption)));
    }

    /// Pictures side by side, each a PNG file's bytes with its caption.
    pub fn pictures(&mut self, pictures: &[(&[u8], &str)]) {
        self.body += "<div class=\"side\">\n";
        for (png, caption) in pictures {
            let (data, caption) = (STANDARD.encode(png), escape(caption));
            self.add(format_args!(
                "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\">\
                 <figcaption>{caption}</figcaption></figure>\n"
            ));
        }
        self.body += "</div>\n";
    }

    /// The whole page.
    pub fn finish(&self) -> String {
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width\"><title>{}</title>\n<style>{STYLE}</style></head>\n\
             <body>\n{}</body></html>\n",
            escape(&self.title),
            self.body
        )
    }

    fn add(&mut self, text: std::fmt::Arguments<'_>) {
        self.body.write_fmt(text).expect("a string takes any text");
    }
}

/// Text for HTML, in elements and in quoted attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            c => out.push(c),
        }
    }
    out
}

/// Whether a cell is a figure, with a sign, a unit or a spread after it.
fn is_number(cell: &str) -> bool {
    cell.trim_start_matches(['-', '+', '−', '±', '<', '≤', '≥', ' ']).starts_with(|c: char| c.is_ascii_digit())
        || matches!(cell, "" | "–" | "∞")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn page_holds_everything_itself_and_escapes_text() {
        let mut page = Page::new("a < b & \"c\"");
        page.heading(2, "<script>");
        page.table(&Table {
            caption: "x > y".into(),
            head: vec!["name".into(), "ms".into()],
            rows: vec![Row::new(["<b>", "1.5"]), Row::marked(Mark::Quoted, ["paper", "−2 ms"])],
        });
        assert_eq!(
            Table {
                caption: "x > y".into(),
                head: vec!["name".into(), "a | b".into()],
                rows: vec![Row::new(["c", "1"]), Row::marked(Mark::Strong, ["d", "2"])],
            }
            .markdown(),
            "x > y\n\n| name | a \\| b |\n|---|---|\n| c | 1 |\n| **d** | **2** |\n"
        );
        page.svg("<?xml version=\"1.0\"?>\n<svg width=\"1\"></svg>", "plot");
        page.pictures(&[(b"\x89PNG", "left \"right\"")]);
        let html = page.finish();
        for part in [
            "<title>a &lt; b &amp; &quot;c&quot;</title>",
            "<h2>&lt;script&gt;</h2>",
            "<tr><td>&lt;b&gt;</td><td class=\"n\">1.5</td></tr>",
            "<tr class=\"quoted\"><td>paper</td><td class=\"n\">−2 ms</td></tr>",
            "<figure><svg width=\"1\">",
            "src=\"data:image/png;base64,iVBORw==\"",
            "alt=\"left &quot;right&quot;\"",
        ] {
            assert!(html.contains(part), "{part} is not in {html}");
        }
        assert!(!html.contains("<script") && !html.contains("http") && !html.contains("<?xml"), "{html}");
    }
}
