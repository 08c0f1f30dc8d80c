//! The address space of this server, and the functions of its methods.

use std::collections::BTreeSet;
use std::sync::Arc;

use async_trait::async_trait;
use opcua::nodes::NodeSetImport;
use opcua::server::address_space::AddressSpace;
use opcua::server::diagnostics::NamespaceMetadata;
use opcua::server::node_manager::memory::{
    InMemoryNodeManager, InMemoryNodeManagerImpl, InMemoryNodeManagerImplBuilder,
};
use opcua::server::node_manager::{MethodCall, RequestContext, ServerContext};
use opcua::sync::RwLock;
use opcua::types::{DataValue, Identifier, NodeId, StatusCode, Variant};
use parking_lot::Mutex;

use crate::access::Access;
use crate::cnc;
use crate::events::{self, Ids};
use crate::instance::{Builder, unknown};
use crate::machine_tool::{self, Spaces};
use crate::methods::{self, Outcome};
use crate::nodesets::{CNC, MACHINE_TOOL, MACHINERY, NodeSet};
use crate::own;
use crate::view::View;

/// Namespace of the nodes of this server. The identifier of each node is its path.
pub const OWN: &str = "https://github.com/tandem-nc/tandem/opcua";

/// The node manager of this server.
pub type Manager = InMemoryNodeManager<Nodes>;

/// Builder of the nodes when the server is created.
pub struct NodesBuilder {
    pub sets: Vec<NodeSet>,
    pub view: View,
    pub access: Arc<Access>,
}

/// The nodes of the machine, in addition to those of the node sets.
pub struct Nodes {
    namespaces: Vec<NamespaceMetadata>,
    own: u16,
    access: Arc<Access>,
    /// Paths of the nodes that were built for the machine.
    built: Mutex<BTreeSet<String>>,
}

impl InMemoryNodeManagerImplBuilder for NodesBuilder {
    type Impl = Nodes;

    fn build(self, context: ServerContext, space: &mut AddressSpace) -> Nodes {
        let mut types = context.type_tree.write();
        let mut namespaces = Vec::new();
        for set in &self.sets {
            space.import_node_set(set, types.namespaces_mut());
            namespaces.extend(set.get_own_namespaces());
        }
        namespaces.push(OWN.to_owned());
        namespaces.sort();
        namespaces.dedup();
        let namespaces: Vec<_> = namespaces
            .into_iter()
            .map(|namespace_uri| NamespaceMetadata {
                namespace_index: types.namespaces_mut().add_namespace(&namespace_uri),
                namespace_uri,
                ..NamespaceMetadata::default()
            })
            .collect();
        for namespace in &namespaces {
            space.add_namespace(&namespace.namespace_uri, namespace.namespace_index);
        }
        let own = space.namespace_index(OWN).unwrap_or_default();
        let built = build(space, own, &self.view);
        let nodes = Nodes {
            namespaces,
            own,
            access: self.access,
            built: Mutex::new(built),
        };
        events::build_types(space, nodes.event_ids());
        nodes
    }
}

/// Builds the nodes of a machine.
fn build(space: &mut AddressSpace, own: u16, view: &View) -> BTreeSet<String> {
    let mut builder = Builder::new(space, own);
    cnc::build(&mut builder, view);
    machine_tool::build(&mut builder, view);
    own::build(&mut builder, view);
    builder.built()
}

impl Nodes {
    /// Returns the identifier of the node at a path, if it exists.
    pub fn id(&self, path: &str) -> Option<NodeId> {
        self.built
            .lock()
            .contains(path)
            .then(|| NodeId::new(self.own, path))
    }

    fn namespace(&self, uri: &str) -> u16 {
        let mut namespaces = self.namespaces.iter();
        let found = namespaces.find(|namespace| namespace.namespace_uri == uri);
        found.map_or(0, |namespace| namespace.namespace_index)
    }

    /// Returns the namespaces of states.
    pub fn spaces(&self) -> Spaces {
        Spaces {
            machine_tool: self.namespace(MACHINE_TOOL),
            machinery: self.namespace(MACHINERY),
        }
    }

    /// Returns the namespaces of events.
    pub fn event_ids(&self) -> Ids {
        Ids {
            cnc: self.namespace(CNC),
            machine_tool: self.namespace(MACHINE_TOOL),
            own: self.own,
        }
    }

    /// Builds the nodes again after the machine was replaced by another one.
    pub fn rebuild(&self, manager: &Manager, view: &View) {
        let mut space = manager.address_space().write();
        let mut built = self.built.lock();
        for path in built.iter() {
            space.delete(&NodeId::new(self.own, path.as_str()), true);
        }
        *built = build(&mut space, self.own, view);
    }
}

/// Returns the value of a variable, or the reason why it has none.
pub fn data_value(value: &Result<Variant, StatusCode>, at: opcua::types::DateTime) -> DataValue {
    let mut written = match value {
        Ok(value) => DataValue::new_now(value.clone()),
        Err(why) => unknown(*why),
    };
    written.source_timestamp = Some(at);
    written
}

#[async_trait]
impl InMemoryNodeManagerImpl for Nodes {
    async fn init(&self, _: &mut AddressSpace, _: ServerContext) {}

    fn name(&self) -> &'static str {
        "tandem"
    }

    fn namespaces(&self) -> Vec<NamespaceMetadata> {
        self.namespaces.clone()
    }

    #[allow(clippy::mut_mut, reason = "the trait has it so")]
    async fn call(
        &self,
        context: &RequestContext,
        _: &RwLock<AddressSpace>,
        calls: &mut [&mut &mut MethodCall],
    ) -> Result<(), StatusCode> {
        for call in calls {
            let Identifier::String(path) = &call.method_id().identifier else {
                continue;
            };
            let Some((cs, method)) = methods::find(path.as_ref()) else {
                continue;
            };
            let outcome = match self.access.plc(&context.token) {
                Some(plc) => methods::call(plc, &context.token, cs, method, call.arguments().to_vec()).await,
                None => Outcome::for_anonymous(),
            };
            call.set_outputs(outcome.outputs());
            call.set_diagnostic_info(outcome.diagnostics());
            call.set_status(outcome.status);
        }
        Ok(())
    }
}

/// Returns the node manager of this server.
pub fn manager(server: &opcua::server::ServerHandle) -> Option<Arc<Manager>> {
    server.node_managers().get_of_type::<Manager>()
}
