//! Instances of types of the node sets.

use std::collections::BTreeSet;

use opcua::nodes::{Base, DefaultTypeTree, EventNotifier, Method, MethodBuilder, NodeType, Object, Variable};
use opcua::server::address_space::{AccessLevel, AddressSpace};
use opcua::types::{
    Argument, BrowseDirection, DataValue, LocalizedText, NodeId, ObjectId, ObjectTypeId, QualifiedName,
    ReferenceTypeId, StatusCode, VariableTypeId, Variant,
};

/// Builds instances in the namespace of this server. The identifier of a node is its path, such as
/// `CNC/CncChannelList/cs1/ActFeedrate`.
pub struct Builder<'a> {
    space: &'a mut AddressSpace,
    /// Index of the namespace of this server.
    own: u16,
    /// Empty, because references of any type are followed.
    no_types: DefaultTypeTree,
    built: BTreeSet<String>,
}

/// A child that a type declares for its instances.
struct DeclaredChild {
    node: NodeId,
    reference: ReferenceTypeId,
    name: QualifiedName,
    type_definition: Option<NodeId>,
    is_mandatory: bool,
}

/// References from a type to the parts of its instances.
const PARTS: [ReferenceTypeId; 4] = [
    ReferenceTypeId::HasComponent,
    ReferenceTypeId::HasProperty,
    ReferenceTypeId::Organizes,
    ReferenceTypeId::HasAddIn,
];

impl<'a> Builder<'a> {
    pub fn new(space: &'a mut AddressSpace, own: u16) -> Self {
        Self {
            space,
            own,
            no_types: DefaultTypeTree::new(),
            built: BTreeSet::new(),
        }
    }

    /// Returns the paths of all nodes that were built.
    pub fn built(self) -> BTreeSet<String> {
        self.built
    }

    fn insert(&mut self, path: &str, node: impl Into<NodeType>) {
        self.space.insert::<_, NodeId>(node, None);
        self.built.insert(path.to_owned());
    }

    /// Returns the identifier of the node at a path.
    pub fn id(&self, path: &str) -> NodeId {
        NodeId::new(self.own, path)
    }

    /// Returns the index of a namespace of the node sets.
    pub fn namespace(&self, uri: &str) -> u16 {
        self.space.namespace_index(uri).unwrap_or_default()
    }

    /// Builds an object of a type with all mandatory parts of its type and those of `optional`, as paths from the type
    /// on.
    pub fn object(
        &mut self,
        path: &str,
        name: QualifiedName,
        type_id: &NodeId,
        parent: &NodeId,
        reference: ReferenceTypeId,
        optional: &[&str],
    ) -> NodeId {
        let id = self.bare_object(path, name, type_id, parent, reference);
        self.parts(&id, path, "", None, Some(type_id), optional);
        id
    }

    /// Builds an object without parts.
    pub fn bare_object(
        &mut self,
        path: &str,
        name: QualifiedName,
        type_id: &NodeId,
        parent: &NodeId,
        reference: ReferenceTypeId,
    ) -> NodeId {
        let id = self.id(path);
        let text = LocalizedText::from(name.name.as_ref());
        let object = Object::new(&id, name, text, EventNotifier::empty());
        self.insert(path, object);
        self.space
            .insert_reference(&id, type_id, ReferenceTypeId::HasTypeDefinition);
        self.space.insert_reference(parent, &id, reference);
        id
    }

    /// Builds a folder in the namespace of this server.
    pub fn folder(&mut self, path: &str, name: &str, parent: &NodeId) -> NodeId {
        let name = QualifiedName::new(self.own, name);
        self.bare_object(
            path,
            name,
            &ObjectTypeId::FolderType.into(),
            parent,
            ReferenceTypeId::Organizes,
        )
    }

    /// Builds a variable in the namespace of this server, without a value yet.
    pub fn variable(
        &mut self,
        path: &str,
        name: &str,
        data_type: impl Into<NodeId>,
        is_array: bool,
        parent: &NodeId,
    ) {
        let id = self.id(path);
        let base = Base::new(
            opcua::types::NodeClass::Variable,
            &id,
            QualifiedName::new(self.own, name),
            name,
        );
        let rank = if is_array { 1 } else { -1 };
        let variable = read_only(
            base,
            data_type.into(),
            rank,
            unknown(StatusCode::BadWaitingForInitialData),
        );
        self.insert(path, variable);
        let type_id: NodeId = VariableTypeId::BaseDataVariableType.into();
        self.space
            .insert_reference(&id, &type_id, ReferenceTypeId::HasTypeDefinition);
        self.space
            .insert_reference(parent, &id, ReferenceTypeId::HasComponent);
    }

    /// Builds a method in the namespace of this server.
    pub fn method(
        &mut self,
        path: &str,
        (name, says): (&str, &str),
        inputs: &[Argument],
        outputs: &[Argument],
        parent: &NodeId,
    ) {
        let id = self.id(path);
        self.built.insert(path.to_owned());
        let inputs_id = self.id(&format!("{path}/InputArguments"));
        let outputs_id = self.id(&format!("{path}/OutputArguments"));
        let builder = MethodBuilder::new(&id, QualifiedName::new(self.own, name), name)
            .description(says)
            .component_of(parent.clone());
        let builder = if inputs.is_empty() {
            builder
        } else {
            self.built.insert(format!("{path}/InputArguments"));
            builder.input_args(self.space, &inputs_id, inputs)
        };
        let builder = if outputs.is_empty() {
            builder
        } else {
            self.built.insert(format!("{path}/OutputArguments"));
            builder.output_args(self.space, &outputs_id, outputs)
        };
        builder.insert(self.space);
    }

    /// Sets the constant value of the variable at a path.
    pub fn set(&mut self, path: &str, value: impl Into<Variant>) {
        let id = self.id(path);
        if let Some(NodeType::Variable(variable)) = self.space.find_mut(&id) {
            variable.set_data_value(DataValue::new_now(value));
        } else {
            tracing::error!(path, "there is no such variable");
        }
    }

    /// Allows clients to subscribe to events of an object.
    pub fn emits_events(&mut self, object: &NodeId) {
        if let Some(NodeType::Object(node)) = self.space.find_mut(object) {
            node.set_event_notifier(EventNotifier::SUBSCRIBE_TO_EVENTS);
        }
        let server: NodeId = ObjectId::Server.into();
        self.space
            .insert_reference(&server, object, ReferenceTypeId::HasNotifier);
    }

    pub fn reference(&mut self, from: &NodeId, to: &NodeId, reference: ReferenceTypeId) {
        self.space.insert_reference(from, to, reference);
    }

    /// Builds the parts of an instance that a declaration and its type require.
    fn parts(
        &mut self,
        parent: &NodeId,
        path: &str,
        from_type: &str,
        declaration: Option<&NodeId>,
        type_id: Option<&NodeId>,
        optional: &[&str],
    ) {
        let mut known = BTreeSet::new();
        let mut sources: Vec<NodeId> = declaration.cloned().into_iter().collect();
        let mut next = type_id.cloned();
        while let Some(id) = next {
            next = self.super_type(&id);
            sources.push(id);
        }
        for source in sources {
            for part in self.declared(&source) {
                let at = if from_type.is_empty() {
                    part.name.name.to_string()
                } else {
                    format!("{from_type}/{}", part.name.name)
                };
                let is_wanted = part.is_mandatory || optional.contains(&at.as_str());
                if is_wanted && known.insert(part.name.name.to_string()) {
                    self.part(parent, path, &at, &part, optional);
                }
            }
        }
    }

    fn part(&mut self, parent: &NodeId, path: &str, at: &str, part: &DeclaredChild, optional: &[&str]) {
        let path = format!("{path}/{}", part.name.name);
        let id = self.id(&path);
        let Some(node) = self.space.find(&part.node) else {
            return;
        };
        let text = node.as_node().display_name().clone();
        let node: NodeType = match node {
            NodeType::Variable(declared) => {
                let base = Base::new(opcua::types::NodeClass::Variable, &id, part.name.clone(), text);
                let value = unknown(StatusCode::BadNotSupported);
                NodeType::Variable(Box::new(read_only(
                    base,
                    declared.data_type(),
                    declared.value_rank(),
                    value,
                )))
            }
            NodeType::Object(_) => NodeType::Object(Box::new(Object::new(
                &id,
                part.name.clone(),
                text,
                EventNotifier::empty(),
            ))),
            NodeType::Method(_) => {
                NodeType::Method(Box::new(Method::new(&id, part.name.clone(), text, false, false)))
            }
            _ => return,
        };
        self.insert(&path, node);
        if let Some(type_id) = &part.type_definition {
            self.space
                .insert_reference(&id, type_id, ReferenceTypeId::HasTypeDefinition);
        }
        self.space.insert_reference(parent, &id, part.reference);
        self.parts(
            &id,
            &path,
            at,
            Some(&part.node),
            part.type_definition.as_ref(),
            optional,
        );
    }

    fn super_type(&self, type_id: &NodeId) -> Option<NodeId> {
        let references = self.references(type_id, BrowseDirection::Inverse);
        let of = references
            .into_iter()
            .find(|(reference, _)| *reference == ReferenceTypeId::HasSubtype);
        of.map(|(_, id)| id)
    }

    fn declared(&self, of: &NodeId) -> Vec<DeclaredChild> {
        let parts = self.references(of, BrowseDirection::Forward).into_iter();
        let mut declared: Vec<DeclaredChild> = parts
            .filter(|(reference, _)| PARTS.contains(reference))
            .filter_map(|(reference, node)| {
                let name = self.space.find(&node)?.as_node().browse_name().clone();
                let of_it = self.references(&node, BrowseDirection::Forward);
                let target = |wanted| {
                    of_it
                        .iter()
                        .find(|(reference, _)| *reference == wanted)
                        .map(|(_, id)| id)
                };
                let rule = target(ReferenceTypeId::HasModellingRule)?;
                Some(DeclaredChild {
                    reference,
                    name,
                    type_definition: target(ReferenceTypeId::HasTypeDefinition).cloned(),
                    is_mandatory: *rule == ObjectId::ModellingRule_Mandatory,
                    node,
                })
            })
            .collect();
        declared.sort_by(|a, b| a.name.name.as_ref().cmp(b.name.name.as_ref()));
        declared
    }

    /// Returns the references of the base namespace.
    fn references(&self, of: &NodeId, direction: BrowseDirection) -> Vec<(ReferenceTypeId, NodeId)> {
        let all = self
            .space
            .find_references(of, None::<(NodeId, bool)>, &self.no_types, direction);
        all.filter_map(|found| {
            Some((
                found.reference_type.as_reference_type_id().ok()?,
                found.target_node.clone(),
            ))
        })
        .collect()
    }
}

/// Returns an unknown value with its reason. Reason: the library treats a variable without a value as good.
pub fn unknown(why: StatusCode) -> DataValue {
    let mut value = DataValue::new_now(Variant::Empty);
    value.status = Some(why);
    value
}

fn read_only(base: Base, data_type: NodeId, rank: i32, value: DataValue) -> Variable {
    let access = AccessLevel::CURRENT_READ.bits();
    Variable::new_full(base, data_type, false, rank, value, access, access, None, None)
}
