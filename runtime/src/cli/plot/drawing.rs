//! Draws the picture of a path: SVG in mm, with a grid from which distances can be read.

use std::fmt::{self, Write as _};

use tandem_model::Axis;

use super::{Stroke, ToolPathLine};

/// Length of the longer side of the picture, in SVG units.
const SIDE: f64 = 1000.0;
/// Margin around the path for the labels, in SVG units.
const MARGIN: f64 = 60.0;
/// Approximate number of grid lines along the longer side.
const GRID_LINES: f64 = 10.0;

/// Content of the picture of a tool path.
pub struct Drawing<'a> {
    /// Name of the program, as a title.
    pub title: &'a str,
    /// Cycle time, s.
    pub cycle_time_s: f64,
    /// Axes that point to the right and up. If `None`, the picture has no grid, because distances cannot be
    /// read from it.
    pub axes: Option<[Axis; 2]>,
    /// Strokes that the legend below the picture explains.
    pub legend: &'a [Stroke],
    /// The tool path, in parts with one stroke each.
    pub lines: &'a [ToolPathLine],
}

impl Drawing<'_> {
    /// Returns the picture as SVG text.
    pub fn to_svg(&self) -> String {
        let mut svg = String::new();
        // Writing into a `String` never fails.
        let _ = self.write(&mut svg);
        svg
    }

    fn write(&self, svg: &mut String) -> fmt::Result {
        let frame = Frame::around(self.lines);
        let [width, height] = frame.size();
        let title = self
            .title
            .replace('&', "&amp;")
            .replace('<', "&lt;")
            .replace('>', "&gt;");
        writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
             font-size=\"14\">\n<style>\n{STYLE}</style>\n<title>{title}</title>\n\
             <rect class=\"paper\" width=\"100%\" height=\"100%\"/>"
        )?;
        if let Some(axes) = self.axes {
            frame.write_grid(svg, axes)?;
        }
        for line in self.lines {
            let class = line.stroke.class();
            let points = line.points.iter().map(|point| frame.at(point.0));
            let points: Vec<String> = points.map(|[x, y]| format!("{x:.2},{y:.2}")).collect();
            let points = points.join(" ");
            writeln!(svg, "<polyline class=\"{class}\" points=\"{points}\"/>")?;
        }
        let start = self.lines.first().and_then(|line| line.points.first());
        let end = self.lines.last().and_then(|line| line.points.last());
        for (class, point) in start
            .map(|start| ("start", start))
            .into_iter()
            .chain(end.map(|end| ("end", end)))
        {
            let [x, y] = frame.at(point.0);
            writeln!(
                svg,
                "<circle class=\"{class}\" cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"5\"><title>{class}</title></circle>"
            )?;
        }
        let y = height - 14.0;
        writeln!(
            svg,
            "<text x=\"14\" y=\"24\">{title}, {:.3} s, mm</text>\n\
             {strokes}\
             <circle class=\"start\" cx=\"196\" cy=\"{line}\" r=\"5\"/><text x=\"208\" y=\"{y}\">start</text>\n\
             <circle class=\"end\" cx=\"262\" cy=\"{line}\" r=\"5\"/><text x=\"274\" y=\"{y}\">end</text>\n</svg>",
            self.cycle_time_s,
            line = y - 5.0,
            strokes = self.strokes(y),
        )
    }
}

impl Drawing<'_> {
    /// Returns the strokes of the legend with their names; the space is sufficient for three.
    fn strokes(&self, y: f64) -> String {
        let line = y - 5.0;
        let each = self.legend.iter().zip([14, 100, 300]).map(|(stroke, x)| {
            let (class, name_x) = (stroke.class(), x + 36);
            format!(
                "<path class=\"{class}\" d=\"M{x} {line} h30\"/><text x=\"{name_x}\" y=\"{y}\">{class}</text>\n"
            )
        });
        each.collect()
    }
}

const STYLE: &str = "\
.paper { fill: #fff }
.grid { stroke: #e3e6ea; stroke-width: 1 }
.zero { stroke: #9aa4b0; stroke-width: 1.5 }
.feed { fill: none; stroke: #0b62c4; stroke-width: 1.6; stroke-linejoin: round }
.rapid { fill: none; stroke: #d9730d; stroke-width: 1.2; stroke-dasharray: 6 4 }
.both { fill: none; stroke: #9aa4b0; stroke-width: 1.6; stroke-linejoin: round }
.old { fill: none; stroke: #c02626; stroke-width: 2; stroke-linejoin: round; stroke-dasharray: 6 4 }
.new { fill: none; stroke: #1a8f3c; stroke-width: 2; stroke-linejoin: round }
.start { fill: #1a8f3c }
.end { fill: #c02626 }
text { fill: #38414c }
";

/// Converts positions in mm to positions in the picture.
struct Frame {
    lowest: [f64; 2],
    highest: [f64; 2],
    /// Picture units per mm.
    scale: f64,
}

impl Frame {
    fn around(lines: &[ToolPathLine]) -> Self {
        let points = || lines.iter().flat_map(|line| &line.points);
        let values = |axis: usize| points().map(move |point| point.0[axis]);
        let lowest = [0, 1].map(|axis| values(axis).reduce(f64::min).unwrap_or_default());
        let highest = [0, 1].map(|axis| values(axis).reduce(f64::max).unwrap_or_default());
        let longer = (highest[0] - lowest[0]).max(highest[1] - lowest[1]);
        // A path of one point is drawn as if it had a length of 1 mm.
        let longer = if longer > 0.0 { longer } else { 1.0 };
        Self {
            lowest,
            highest,
            scale: SIDE / longer,
        }
    }

    /// Returns the width and the height of the picture, in SVG units.
    fn size(&self) -> [f64; 2] {
        let side = |axis: usize| (self.highest[axis] - self.lowest[axis]) * self.scale + 2.0 * MARGIN;
        // The legend needs a width of 400 units.
        [side(0).max(400.0), side(1)]
    }

    fn at(&self, [right, up]: [f64; 2]) -> [f64; 2] {
        [
            MARGIN + (right - self.lowest[0]) * self.scale,
            MARGIN + (self.highest[1] - up) * self.scale,
        ]
    }

    /// Returns the distance between grid lines in mm: 1, 2 or 5 times a power of ten.
    fn step(&self) -> f64 {
        let wished = SIDE / self.scale / GRID_LINES;
        let power = 10_f64.powf(wished.log10().floor());
        let factor = [1.0, 2.0, 5.0]
            .into_iter()
            .find(|factor| factor * power >= wished);
        factor.unwrap_or(10.0) * power
    }

    fn write_grid(&self, svg: &mut String, axes: [Axis; 2]) -> fmt::Result {
        let step = self.step();
        let digits = if step >= 1.0 { 0 } else { 3 };
        let [low, high] = [self.lowest, self.highest];
        // For each of the two axes: position of the labels of its values, and position of its letter.
        let places = [
            (
                "dy=\"18\" text-anchor=\"middle\"",
                [high[0], low[1]],
                "dx=\"24\" dy=\"18\"",
            ),
            (
                "dx=\"-6\" dy=\"5\" text-anchor=\"end\"",
                [low[0], high[1]],
                "dx=\"-12\" dy=\"-16\"",
            ),
        ];
        for (index, (axis, (label, letter_at, letter_place))) in axes.into_iter().zip(places).enumerate() {
            let mut value = (low[index] / step).ceil() * step;
            while value <= high[index] {
                let class = if value.abs() < step / 2.0 { "zero" } else { "grid" };
                let ends = [low, high].map(|mut end| {
                    end[index] = value;
                    self.at(end)
                });
                let [[x1, y1], [x2, y2]] = ends;
                // Adding zero removes the sign of a negative zero.
                let shown = value + 0.0;
                writeln!(
                    svg,
                    "<line class=\"{class}\" x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\"/>\n\
                     <text x=\"{x1:.2}\" y=\"{y1:.2}\" {label}>{shown:.digits$}</text>"
                )?;
                value += step;
            }
            let [x, y] = self.at(letter_at);
            let letter = axis.letter();
            writeln!(
                svg,
                "<text x=\"{x:.2}\" y=\"{y:.2}\" {letter_place} font-weight=\"bold\">{letter}</text>"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::polyline::Point;
    use super::*;

    fn picture(points: &[[f64; 2]], rapid: bool) -> String {
        let lines = [ToolPathLine {
            stroke: Stroke::from_rapid(rapid),
            points: points.iter().copied().map(Point).collect(),
        }];
        let drawing = Drawing {
            title: "a<b.nc",
            cycle_time_s: 1.5,
            axes: Some([Axis::X, Axis::Y]),
            legend: &[Stroke::Feed, Stroke::Rapid],
            lines: &lines,
        };
        drawing.to_svg()
    }

    #[test]
    fn x_goes_to_the_right_and_y_up_in_one_scale() {
        // 200 mm are 1000 units. So X 50 is 250 units to the right and Y 100 is 500 units up; the lowest
        // point is at the bottom left.
        let svg = picture(&[[0.0, 0.0], [200.0, 0.0], [50.0, 100.0]], false);
        assert!(
            svg.contains("points=\"60.00,560.00 1060.00,560.00 310.00,60.00\""),
            "{svg}"
        );
        assert!(svg.contains("viewBox=\"0 0 1120 620\""), "{svg}");
    }

    #[test]
    fn rapid_and_feed_look_different() {
        let way = [[0.0, 0.0], [1.0, 1.0]];
        assert!(picture(&way, true).contains("<polyline class=\"rapid\""));
        assert!(picture(&way, false).contains("<polyline class=\"feed\""));
    }

    #[test]
    fn the_grid_has_round_distances_and_labels() {
        let svg = picture(&[[-3.0, 0.0], [70.0, 20.0]], false);
        for label in [">0<", ">10<", ">70<"] {
            assert!(svg.contains(label), "{label} {svg}");
        }
        assert!(!svg.contains(">75<"), "{svg}");
    }

    #[test]
    fn a_name_of_a_file_is_no_markup() {
        assert!(picture(&[[0.0, 0.0], [1.0, 0.0]], false).contains("a&lt;b.nc"));
    }

    #[test]
    fn a_program_that_does_not_move_is_a_picture_too() {
        let drawing = Drawing {
            title: "",
            cycle_time_s: 0.0,
            axes: Some([Axis::X, Axis::Y]),
            legend: &[Stroke::Feed, Stroke::Rapid],
            lines: &[],
        };
        let svg = drawing.to_svg();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }
}
