// Messages of the machine: types of its topics, re-exported from the HMI. The package has the types here.
export * from "../../../web/types.d.ts";
