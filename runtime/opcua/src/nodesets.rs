//! The information models of the OPC Foundation, as data in this program.

use anyhow::Context;
use opcua::nodes::{ImportedItem, NodeSet2Import, NodeSetImport, NodeSetNamespaceMapper};

/// OPC 40502, CNC systems.
pub const CNC: &str = "http://opcfoundation.org/UA/CNC";

/// OPC 40501, machine tools.
pub const MACHINE_TOOL: &str = "http://opcfoundation.org/UA/MachineTool/";

/// OPC 40001, machinery.
pub const MACHINERY: &str = "http://opcfoundation.org/UA/Machinery/";

/// Ordered so that each file comes after those that it requires.
const FILES: [(&str, &str); 7] = [
    ("DI", include_str!("../nodesets/Opc.Ua.Di.NodeSet2.xml")),
    ("IA", include_str!("../nodesets/Opc.Ua.IA.NodeSet2.xml")),
    (
        "Machinery",
        include_str!("../nodesets/Opc.Ua.Machinery.NodeSet2.xml"),
    ),
    (
        "ISA-95",
        include_str!("../nodesets/opc.ua.isa95-jobcontrol.nodeset2.xml"),
    ),
    (
        "Machinery Jobs",
        include_str!("../nodesets/Opc.Ua.Machinery.Jobs.Nodeset2.xml"),
    ),
    (
        "Machine Tool",
        include_str!("../nodesets/Opc.Ua.MachineTool.NodeSet2.xml"),
    ),
    ("CNC", include_str!("../nodesets/Opc.Ua.CNC.NodeSet.xml")),
];

/// Reads all node sets.
///
/// # Errors
/// Fails if a file is not a node set, which is a defect of this program.
pub fn read() -> anyhow::Result<Vec<NodeSet>> {
    FILES
        .iter()
        .map(|(name, text)| {
            let set = NodeSet2Import::new_str("en", &without_blanks_in_bytes(text), Vec::new());
            set.map(NodeSet).with_context(|| format!("the node set {name}"))
        })
        .collect()
}

/// Joins each byte string into one line: XML allows spaces in them, the library does not.
fn without_blanks_in_bytes(text: &str) -> String {
    let mut said = String::with_capacity(text.len());
    for (index, element) in text.split('<').enumerate() {
        if index > 0 {
            said.push('<');
        }
        let tag = element
            .split(|letter: char| letter == '>' || letter.is_whitespace())
            .next();
        match element.split_once('>') {
            Some((mark, bytes)) if matches!(tag, Some("uax:ByteString" | "ByteString")) => {
                said.push_str(mark);
                said.push('>');
                said.extend(bytes.split_ascii_whitespace());
            }
            _ => said.push_str(element),
        }
    }
    said
}

/// One node set.
pub struct NodeSet(NodeSet2Import);

impl NodeSetImport for NodeSet {
    // the implementation of the library prints to standard output
    fn register_namespaces(&self, namespaces: &mut NodeSetNamespaceMapper) {
        for (index, uri) in (1..).zip(self.get_own_namespaces()) {
            namespaces.add_namespace(&uri, index);
        }
    }

    fn get_own_namespaces(&self) -> Vec<String> {
        self.0.get_own_namespaces()
    }

    fn load<'a>(
        &'a self,
        namespaces: &'a NodeSetNamespaceMapper,
    ) -> Box<dyn Iterator<Item = ImportedItem> + 'a> {
        self.0.load(namespaces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_string_is_one_line_and_the_rest_is_as_it_was() {
        let text = "<a b='ByteString'>\n<uax:ByteString c='d'>QU\n  JD</uax:ByteString>\n x </a>";
        let said = "<a b='ByteString'>\n<uax:ByteString c='d'>QUJD</uax:ByteString>\n x </a>";
        assert_eq!(without_blanks_in_bytes(text), said);
    }
}
