//! The derive macro of plc-api; plc-api re-exports it as `plc_api::Params`.

use proc_macro::TokenStream;
use quote::quote;
use syn::parse::{Parse, ParseStream};
use syn::punctuated::Punctuated;
use syn::{
    Attribute, Data, DeriveInput, Expr, ExprRange, Field, Fields, Ident, LitStr, RangeLimits, Result, Token,
};

/// Attributes of fields for the parameters VA to VH.
const LETTERS: [&str; 8] = ["va", "vb", "vc", "vd", "ve", "vf", "vg", "vh"];

/// Error text with the allowed contents of an attribute.
const FORM: &str = "write a range such as 1..=20, a unit such as \"kN\", and name = \"...\" where the field has another name";

/// Derives an extractor for a struct: a handler takes the parameters of an M code as one argument. Each field
/// has one of the attributes `#[va]` to `#[vh]`. An attribute may contain:
///
/// - the range of the numbers, with both ends or one end: `1..=20`, `0.5..`, `..=3`,
/// - the unit: `"kN"`,
/// - the name, if it differs from the name of the field: `name = "clamping force"`.
///
/// A parameter must be programmed if the type of its field is `f64`, an integer of up to 32 bits, `bool`, a
/// unit, or a type with your own implementation of `ParamValue`. If the type of the field is an `Option` of
/// one of these, the parameter may be left out. The M code accepts no other parameters. For an example see
/// `plc_api::extract`.
#[proc_macro_derive(Params, attributes(va, vb, vc, vd, ve, vf, vg, vh))]
pub fn params(input: TokenStream) -> TokenStream {
    let input = syn::parse_macro_input!(input as DeriveInput);
    let written = write(&input);
    written
        .unwrap_or_else(|mistake| mistake.to_compile_error())
        .into()
}

fn write(input: &DeriveInput) -> Result<proc_macro2::TokenStream> {
    let name = &input.ident;
    if !input.generics.params.is_empty() {
        let text = "parameters of an M code have no generics";
        return Err(syn::Error::new_spanned(&input.generics, text));
    }
    let fields = match &input.data {
        Data::Struct(data) => match &data.fields {
            Fields::Named(fields) => fields.named.iter().collect(),
            Fields::Unit => Vec::new(),
            Fields::Unnamed(_) => return Err(no_struct(name)),
        },
        _ => return Err(no_struct(name)),
    };
    let params = fields
        .into_iter()
        .map(Param::from_field)
        .collect::<Result<Vec<_>>>()?;
    for (index, param) in params.iter().enumerate() {
        if params[..index].iter().any(|other| other.letter == param.letter) {
            let text = format!("V{} is declared twice", param.letter);
            return Err(syn::Error::new(param.field.span(), text));
        }
    }
    let declared = params.iter().map(Param::declared);
    let values = params.iter().map(Param::value);
    Ok(quote! {
        impl ::plc_api::extract::FromOutput for #name {
            fn takes(takes: &mut ::plc_api::extract::Takes) {
                takes.no_other_params();
                #(#declared)*
            }

            fn from_output(
                output: &::plc_api::AuxOutput,
                _plc: &::plc_api::Plc,
            ) -> ::core::result::Result<Self, ::plc_api::Alarm> {
                ::core::result::Result::Ok(Self { #(#values),* })
            }
        }
    })
}

fn no_struct(name: &Ident) -> syn::Error {
    syn::Error::new(
        name.span(),
        "parameters of an M code are a struct whose fields have names",
    )
}

/// A field of the struct that stands for a parameter.
struct Param<'a> {
    field: &'a Ident,
    of: &'a syn::Type,
    /// Letter of the parameter, `A` to `H`.
    letter: Ident,
    form: Form,
}

impl<'a> Param<'a> {
    fn from_field(field: &'a Field) -> Result<Self> {
        let Some(ident) = &field.ident else {
            return Err(syn::Error::new_spanned(field, "the field has no name"));
        };
        let mut found = None;
        for attribute in &field.attrs {
            let Some(letter) = letter(attribute) else { continue };
            if found.is_some() {
                let text = "a field is one parameter: leave one of #[va] to #[vh]";
                return Err(syn::Error::new_spanned(attribute, text));
            }
            found = Some((letter, Form::from_attribute(attribute)?));
        }
        let Some((letter, form)) = found else {
            let text = format!("which parameter is {ident}? Write one of #[va] to #[vh] before it");
            return Err(syn::Error::new(ident.span(), text));
        };
        Ok(Self {
            field: ident,
            of: &field.ty,
            letter,
            form,
        })
    }

    fn declared(&self) -> proc_macro2::TokenStream {
        let Self {
            field,
            of,
            letter,
            form,
        } = self;
        let own = field.to_string();
        let own = own.strip_prefix("r#").unwrap_or(&own).replace('_', " ");
        let name = form.name.as_ref().map_or(own, LitStr::value);
        let unit = form.unit.iter();
        let bound = |bound: &Option<Box<Expr>>| {
            let some = bound
                .as_ref()
                .map(|bound| quote!(::core::option::Option::Some(::core::convert::Into::into(#bound))));
            some.unwrap_or_else(|| quote!(::core::option::Option::None))
        };
        let (min, max) = form
            .range
            .as_ref()
            .map_or((&None, &None), |range| (&range.start, &range.end));
        let (min, max) = (bound(min), bound(max));
        quote! {{
            let mut declaration = <#of as ::plc_api::extract::ParamValue>::declaration().within(#min, #max);
            declaration.name = ::core::option::Option::Some(::std::string::String::from(#name));
            #(declaration.unit = ::core::option::Option::Some(::std::string::String::from(#unit));)*
            takes.param(::plc_api::types::m_code::ParamLetter::#letter, declaration);
        }}
    }

    fn value(&self) -> proc_macro2::TokenStream {
        let Self { field, letter, .. } = self;
        quote!(#field: ::plc_api::extract::param(output, ::plc_api::types::m_code::ParamLetter::#letter)?)
    }
}

/// Returns the letter of an attribute, or `None` if the attribute is not one of `#[va]` to `#[vh]`.
fn letter(attribute: &Attribute) -> Option<Ident> {
    let name = LETTERS.iter().find(|name| attribute.path().is_ident(name))?;
    let letter = name[1..].to_uppercase();
    Some(Ident::new(&letter, attribute.path().get_ident()?.span()))
}

/// Contents of an attribute `#[va(..)]` to `#[vh(..)]`.
#[derive(Default)]
struct Form {
    range: Option<ExprRange>,
    unit: Option<LitStr>,
    name: Option<LitStr>,
}

impl Form {
    fn from_attribute(attribute: &Attribute) -> Result<Self> {
        let mut form = Self::default();
        if matches!(attribute.meta, syn::Meta::Path(_)) {
            return Ok(form);
        }
        for part in attribute.parse_args_with(Punctuated::<Part, Token![,]>::parse_terminated)? {
            let is_second = match part {
                Part::Range(range) => form.range.replace(range).is_some(),
                Part::Unit(unit) => form.unit.replace(unit).is_some(),
                Part::Name(name) => form.name.replace(name).is_some(),
            };
            if is_second {
                return Err(syn::Error::new_spanned(
                    attribute,
                    format!("this occurs twice: {FORM}"),
                ));
            }
        }
        Ok(form)
    }
}

/// One element of an attribute: range, unit or name.
enum Part {
    Range(ExprRange),
    Unit(LitStr),
    Name(LitStr),
}

impl Parse for Part {
    fn parse(input: ParseStream<'_>) -> Result<Self> {
        if input.peek(LitStr) {
            return input.parse().map(Self::Unit);
        }
        if input.peek(Ident) && input.peek2(Token![=]) {
            let word: Ident = input.parse()?;
            input.parse::<Token![=]>()?;
            if word != "name" {
                return Err(syn::Error::new(word.span(), FORM));
            }
            return input.parse().map(Self::Name);
        }
        let expression: Expr = input.parse()?;
        match expression {
            Expr::Range(range) if matches!(range.limits, RangeLimits::HalfOpen(_)) && range.end.is_some() => {
                let text = "a parameter takes both ends of its range: write ..= in the place of ..";
                Err(syn::Error::new_spanned(range, text))
            }
            Expr::Range(range) => Ok(Self::Range(range)),
            Expr::Path(path) if path.path.is_ident("optional") => {
                let text =
                    "a parameter that may be left out is an Option<..>: write it as the type of the field";
                Err(syn::Error::new_spanned(path, text))
            }
            other => Err(syn::Error::new_spanned(other, FORM)),
        }
    }
}
