//! The features of IEC 61131-3 in this subset: a row for each feature, with the test that proves it.

/// A feature.
#[derive(Debug, PartialEq, Eq)]
pub struct Feature {
    /// Title of the table in the standard's third edition that contains the feature.
    pub table: &'static str,
    /// The feature.
    pub feature: &'static str,
    /// Behaviour where the standard leaves it open.
    pub note: &'static str,
    /// Name of the test.
    pub test: &'static str,
}

macro_rules! features {
    ($($table:literal { $($feature:literal, $note:literal => $test:ident;)* })*) => {
        /// All features.
        pub static FEATURES: &[Feature] = &[$($(Feature {
            table: $table, feature: $feature, note: $note, test: stringify!($test),
        }),*),*];
    };
}

features! {
    "Identifiers" {
        "Upper and lower case, digits, underscores", "upper and lower case are equal" => names_have_no_case;
    }
    "Comments" {
        "`//`, `(* *)`, `/* */`, also nested", "" => comments_of_three_kinds_stand_within_each_other;
    }
    "Numeric literals" {
        "Integers `-12`, `123_456`", "" => integer_literals;
        "Reals `-12.0`, `3.14159_26`, `-1.34E-12`", "" => real_literals;
        "Bases 2, 8 and 16", "" => based_literals;
        "`BOOL`: `0`, `1` as `BOOL#0`, `FALSE`, `TRUE`", "" => bool_literals;
        "Typed literals `DINT#5`, `UINT#16#9AF`", "" => typed_literals;
    }
    "Character string literals" {
        "`'A'`, empty strings, `$` and two hexadecimal digits", "" => string_literals;
        "`$$ $' $L $N $P $R $T`", "" => dollar_sequences;
    }
    "Duration literals" {
        "`T#14ms`, `T#-14ms`, `T#14.7s`, `T#5d14h12m18s3.5ms`, underscores, `TIME#`", "" => duration_literals;
    }
    "Elementary data types" {
        "`SINT` to `LINT`, `USINT` to `ULINT`, their ranges", "a value out of its range stops the program" => integers_have_their_ranges;
        "`REAL` of 32 bits, `LREAL` of 64", "a result that is infinite or not a number stops the program" => reals_have_their_precision;
        "`BYTE`, `WORD`, `DWORD`, `LWORD`", "" => bit_strings_have_their_widths;
        "`TIME`", "in nanoseconds, 64 bits" => time_counts_nanoseconds;
        "`STRING`, `STRING[n]`", "1 to 1000 characters of Unicode, 255 without a length; a longer value stops the program" => strings_have_their_lengths;
        "Default initial values", "" => variables_without_a_value_begin_with_0;
    }
    "User-defined data types" {
        "Enumerations, `Type#Value`", "" => enumerations;
        "Arrays", "up to 8 dimensions" => arrays_have_bounds_and_dimensions;
        "Structures", "" => structures;
        "Other names for types", "" => other_names_for_types;
    }
    "Variable declaration and initialisation" {
        "`VAR`, `VAR CONSTANT`, values at the start", "" => variables_begin_with_their_values;
        "Values at the start of arrays `[1, 2(0)]` and structures `(A := 1)`", "" => arrays_and_structures_begin_with_their_values;
        "Inputs of function blocks in their declaration", "" => instances_begin_with_their_inputs;
        "`VAR_TEMP`", "" => temporary_variables_begin_anew_in_each_call;
        "`VAR_INPUT` cannot be assigned within its unit, a constant not at all", "" => inputs_and_constants_are_not_assigned;
    }
    "Function declaration and call" {
        "`FUNCTION`, its result assigned to its name, `RETURN`", "" => functions_give_what_their_name_is_assigned;
        "Parameters by order, or by name with `:=` and `=>`", "not both in one call" => parameters_by_order_and_by_name;
        "`VAR_IN_OUT`", "" => in_outs_change_the_variable_that_is_passed;
        "A function keeps no values from call to call", "" => functions_keep_nothing;
        "No recursion", "" => recursion_is_refused;
    }
    "Function block declaration and call" {
        "`FUNCTION_BLOCK`, instances, `a.Q`", "" => function_blocks_keep_their_variables;
        "Inputs without an argument keep their values", "" => inputs_that_are_not_given_stay;
        "Outputs by `=>`", "" => outputs_go_where_the_arrow_points;
        "Instances within instances and in arrays", "" => instances_within_instances_and_arrays;
    }
    "Implicit and explicit conversion" {
        "Implicit conversion to a wider type, never to a narrower one", "" => types_become_wider_by_themselves_only;
        "`*_TO_**` between integers", "a value that does not fit stops the program" => integers_are_converted;
        "`REAL_TO_INT` rounds to the nearest, halves to even", "" => reals_are_rounded_to_even;
        "`TRUNC`, `*_TRUNC_**`, `TRUNC_**`", "`TRUNC` gives `DINT`" => trunc_goes_towards_zero;
        "`TO_**`", "" => to_takes_every_type;
        "Bit strings and integers: the bits are transferred", "" => bits_are_transferred;
        "Times and numbers", "milliseconds" => times_are_numbers_of_milliseconds;
        "Strings and numbers", "" => strings_are_numbers;
    }
    "Numerical functions" {
        "`ABS`, `SQRT`, `LN`, `LOG`, `EXP`", "" => numerical_functions;
        "`SIN`, `COS`, `TAN`, `ASIN`, `ACOS`, `ATAN`, `ATAN2`", "" => trigonometric_functions;
    }
    "Arithmetic functions" {
        "`ADD`, `MUL`, `SUB`, `DIV`, `MOD`, `EXPT`, `MOVE`", "" => arithmetic_functions;
    }
    "Bit shift and Boolean functions" {
        "`SHL`, `SHR`, `ROL`, `ROR`", "" => shifts_and_rotations;
        "`AND`, `OR`, `XOR`, `NOT`", "" => boolean_functions;
    }
    "Selection and comparison functions" {
        "`SEL`, `MAX`, `MIN`, `LIMIT`, `MUX`", "" => selection_functions;
        "`GT`, `GE`, `EQ`, `LE`, `LT`, `NE`", "" => comparison_functions;
    }
    "Character string functions" {
        "`LEN`, `LEFT`, `RIGHT`, `MID`, `CONCAT`", "" => parts_of_strings;
        "`INSERT`, `DELETE`, `REPLACE`, `FIND`", "" => changes_of_strings;
    }
    "Functions of time" {
        "`TIME` + `-` `TIME`, `TIME` `*` `/` number", "" => times_are_added_and_scaled;
    }
    "Standard function blocks" {
        "`SR`, `RS`", "" => bistable_function_blocks;
        "`R_TRIG`, `F_TRIG`", "" => edge_detection_function_blocks;
        "`CTU`, `CTD`, `CTUD`", "`PV` and `CV` are `LINT`" => counter_function_blocks;
        "`TON`, `TOF`, `TP`", "use the time of the scan" => timer_function_blocks;
    }
    "Operators of the ST language" {
        "Precedence, and evaluation from left to right", "`**` after a sign, and two `**` in a row, need parentheses, because editions of the standard differ" => operators_bind_as_in_the_table;
        "`/` of integers towards 0, `MOD`", "`a MOD 0` is 0" => integer_division_goes_towards_zero;
        "`AND` and `OR` of `BOOL`", "the right side is evaluated only if it decides the result" => and_and_or_end_early;
        "Comparisons of numbers, strings, times, enumerations", "" => comparisons;
    }
    "ST language statements" {
        "`:=` of values, arrays and structures", "" => assignments;
        "`IF`, `ELSIF`, `ELSE`", "" => if_takes_the_first_that_is_true;
        "`CASE` with lists and ranges", "" => case_takes_lists_and_ranges;
        "`FOR`, `BY`", "after the loop, the variable is one step beyond the last value, if its type has that value" => for_counts_up_and_down;
        "`WHILE`, `REPEAT`", "" => while_and_repeat;
        "`EXIT`, `CONTINUE`", "" => exit_and_continue_act_on_the_innermost_loop;
        "`RETURN`", "" => return_ends_its_unit;
    }
    "Errors" {
        "A division by zero", "the program stops, with an alarm that names the line and the variable" => a_division_by_zero_stops_the_program;
        "An index out of range", "" => an_index_out_of_range_stops_the_program;
        "A loop without end", "after 1,000,000 steps of one scan" => a_loop_without_end_stops_the_program;
    }
}
