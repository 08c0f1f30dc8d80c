//! Converts byte offsets to lines and columns.

/// Line starts of a source text. Lines and columns are numbered from 1; columns are characters.
#[derive(Debug, Clone)]
pub struct LineIndex<'a> {
    source: &'a str,
    starts: Vec<u32>,
}

impl<'a> LineIndex<'a> {
    /// Finds the line starts of a text. A byte order mark at the beginning is not a character of the first
    /// line.
    pub fn new(source: &'a str) -> Self {
        let first = if source.starts_with('\u{feff}') { 3 } else { 0 };
        let mut starts = vec![first];
        starts.extend(
            source
                .bytes()
                .zip(1_u32..)
                .filter_map(|(byte, next)| (byte == b'\n').then_some(next)),
        );
        Self { source, starts }
    }

    /// Returns the line and column of a byte offset. An offset past the end gives the end of the text; an
    /// offset within a character gives the position of the character.
    pub fn locate(&self, offset: u32) -> (u32, u32) {
        let line = self.starts.partition_point(|start| *start <= offset).max(1);
        let start = self.starts[line - 1] as usize;
        let mut end = (offset as usize).min(self.source.len()).max(start);
        while !self.source.is_char_boundary(end) {
            end -= 1;
        }
        let column = self.source[start..end].chars().count() + 1;
        (
            u32::try_from(line).unwrap_or(u32::MAX),
            u32::try_from(column).unwrap_or(u32::MAX),
        )
    }

    /// Returns the text of a line without its line end; empty if the text does not have this line.
    pub fn line_text(&self, line: u32) -> &'a str {
        let index = line as usize;
        let Some(start) = index.checked_sub(1).and_then(|before| self.starts.get(before)) else {
            return "";
        };
        let end = self
            .starts
            .get(index)
            .map_or(self.source.len(), |next| *next as usize);
        let text = &self.source[*start as usize..end];
        let text = text.strip_suffix('\n').unwrap_or(text);
        text.strip_suffix('\r').unwrap_or(text)
    }

    /// Returns the number of lines; a text without a line feed has one line.
    pub fn line_count(&self) -> usize {
        self.starts.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_and_columns_count_from_one_in_characters() {
        let index = LineIndex::new("G01 X1\r\n// äö X2\nM30");
        assert_eq!(index.locate(0), (1, 1));
        assert_eq!(index.locate(4), (1, 5));
        assert_eq!(index.locate(8), (2, 1));
        // "// äö " is 6 characters in 8 bytes
        assert_eq!(index.locate(16), (2, 7));
        assert_eq!(index.locate(19), (3, 1));
        assert_eq!(index.locate(9999), (3, 4));
        assert_eq!(index.line_text(1), "G01 X1");
        assert_eq!(index.line_text(2), "// äö X2");
        assert_eq!(index.line_text(3), "M30");
        assert_eq!(index.line_text(0), "");
        assert_eq!(index.line_text(4), "");
        assert_eq!(index.line_count(), 3);
    }

    #[test]
    fn a_byte_order_mark_is_no_column() {
        let index = LineIndex::new("\u{feff}G01\nX1");
        assert_eq!(index.locate(0), (1, 1));
        assert_eq!(index.locate(3), (1, 1));
        assert_eq!(index.locate(5), (1, 3));
        assert_eq!(index.line_text(1), "G01");
    }

    #[test]
    fn a_place_inside_a_character_is_its_first_byte() {
        assert_eq!(LineIndex::new("aä").locate(2), (1, 2));
    }
}
