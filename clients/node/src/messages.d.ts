// What the machine says: the forms of its topics, those of the HMI. In the package this file is they themselves.
export * from "../../../web/types.d.ts";
