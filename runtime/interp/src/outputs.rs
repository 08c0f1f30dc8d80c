//! The auxiliary function outputs of a program, as far as its text shows them.

use tandem_model::limits::M_CODE_MAX;
use tandem_syntax::{Address, NcProgram, Word};

use crate::codes::m_auxiliary::parameter_index;
use crate::dialect::Dialect;
use crate::meaning::Role;

/// An auxiliary function output, with the words of its block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProgrammedOutput<'a> {
    /// M number of the output.
    pub m: u16,
    /// The word of the M code.
    pub word: &'a Word,
    /// The words of VA to VH; `None` for a parameter that is not programmed.
    pub params: [Option<&'a Word>; 8],
    /// Line of the source file, from 1.
    pub line: u32,
}

/// An auxiliary function output, with the numbers in the text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrittenOutput {
    /// M number of the output.
    pub m: u16,
    /// Values of VA to VH; `None` for a parameter that is not programmed.
    pub params: [Option<f64>; 8],
    /// Line of the source file, from 1.
    pub line: u32,
}

/// Returns the outputs of a program, in the order of the text.
pub fn programmed_outputs<'a>(
    program: &'a NcProgram,
    dialect: &Dialect,
) -> impl Iterator<Item = ProgrammedOutput<'a>> {
    program.blocks().iter().filter_map(|block| {
        let words = program.words(block);
        let word = words.iter().find(|word| word.address == Address::M)?;
        let m = u16::try_from(word.whole()?).ok().filter(|m| *m <= M_CODE_MAX)?;
        let listed = dialect.m_codes.find(m * 10);
        if listed.is_some_and(|code| code.role != Role::Auxiliary) {
            return None;
        }
        let mut params = [None; 8];
        for word in words {
            let place = parameter_index(word.address).and_then(|index| params.get_mut(index));
            if let Some(place) = place {
                *place = Some(word);
            }
        }
        Some(ProgrammedOutput {
            m,
            word,
            params,
            line: block.line,
        })
    })
}

/// Returns the outputs of a program whose parameters are all numbers, in the order of the text. An output
/// with a variable as a parameter (D04) is omitted, because the value is known only when its block runs.
pub fn written_outputs(program: &NcProgram, dialect: &Dialect) -> impl Iterator<Item = WrittenOutput> {
    programmed_outputs(program, dialect).filter_map(|output| {
        let mut params = [None; 8];
        for (number, word) in params.iter_mut().zip(output.params) {
            if let Some(word) = word {
                *number = Some(word.number()?);
            }
        }
        Some(WrittenOutput {
            m: output.m,
            params,
            line: output.line,
        })
    })
}

#[cfg(test)]
mod tests {
    use tandem_syntax::{Grammar, parse};

    use super::*;
    use crate::dialects;

    #[test]
    fn outputs_are_found_with_their_parameters_and_lines() {
        let text = "N1 G90 G01 X1 M08\nM100 VA3 VH-0.5\nM98 P1000\n/1 M100 VB2\nM100 VA[P3]\nM00\nM30\n";
        let (program, found) = parse(text, Grammar::nj());
        assert_eq!(found, []);
        let params = |a, b, h| [a, b, None, None, None, None, None, h];
        let written: Vec<_> = written_outputs(&program, dialects::nj()).collect();
        let expected = [
            (8, params(None, None, None), 1),
            (100, params(Some(3.0), None, Some(-0.5)), 2),
            (100, params(None, Some(2.0), None), 4),
        ];
        assert_eq!(
            written,
            expected.map(|(m, params, line)| WrittenOutput { m, params, line })
        );
    }
}
