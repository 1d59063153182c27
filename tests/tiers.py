"""What stays out of the first tier, the one that a newcomer runs, and why.

The rule: a test that takes more than about four seconds of processor time (`--costs`
measures it) is here, unless nothing else looks at its part of the package and it takes
less than some forty. So the first tier follows no branch, finds no fold along one, no
least kick and no torus, and starts no cluster. An entry is the beginning of a test's
name, below `tests`. `pytest -m ""` runs both tiers, as CI does,
and `--night` the large draws beside them.
"""

LONG_PROGRAMS = (
    "branches, folds, curves, least kicks: a program of ten seconds to compile"
)
CERTIFIED = (
    "a certified map's program, five seconds to compile; others see the same code"
)
LONG_RUNS = "thousands of motions, long ones, or another code's many steps"
PROCESSES = "starts Python anew, once or several times"
ALL_QUESTIONS = "traces or compiles every question, for options that all of them share"
OTHER_WAY = "the same claim of another law, method or option; one of each kind is quick"
TASKS = "a user's script or a docstring's example with a large scene"


# Run with `--night`, in no tier: large draws, of which small ones are in the tiers.
NIGHT = [
    "test_derivatives.py::test_derivatives_are_right_or_listed[periodic_orbit",
    "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[smoothed-1",
    "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[viscous-2",
    "test_derivatives.py::test_derivatives_of_long_motions",
    "sweep/test_stores_under_attack.py::test_a_sweep_stopped_before_a_file_operation"
    "_goes_on[all]",
    "steady/test_endings.py::test_of_many",
    "sweep/test_stores_under_attack.py::test_any_file_may_be_damaged[all",
    "steady/test_dry_certificates.py::test_multipliers_of_200_columns",
    # a small run compiles as much as a large one; the cheaper ones are in the tiers
    *(
        f"test_benchmarks.py::test_a_script_runs[{name}"
        for name in ("a12", "a13", "a15", "a3", "a5", "a9", "b0", "b1", "b3", "c0")
    ),
]

# Files of few tests that take long, dearest first: they are begun first, so that in the
# end no process waits for another's last file.
FIRST = [
    "test_benchmarks.py",
    "test_docstring_examples.py",
    "analysis/test_section_planes.py",
    "test_examples.py",
    "motion/test_stick_and_slip.py",
    "analysis/test_least_kicks.py",
    "analysis/test_thresholds.py",
    "analysis/test_cycles.py",
    "curves/test_flips_and_tori.py",
    "curves/test_bifurcation_curves.py",
    "curves/test_changes_of_modes.py",
    "test_main.py",
    "steady/test_endings.py",
    "steady/test_certificates.py",
    "steady/test_same_certificates.py",
    "steady/test_growth.py",
    "steady/test_tangents_of_the_field.py",
    "analysis/test_branches.py",
    "test_studies.py",
    "test_census.py",
]

SLOW = {
    LONG_PROGRAMS: [
        "curves/test_bifurcation_curves.py::test_folds_of_dry_friction_are_another_codes",
        "curves/test_bifurcation_curves.py::test_curves_of_folds_end_at_their_bounds_and",
        "curves/test_bifurcation_curves.py::test_folds_move_with_a_third_parameter_as_th",
        "steady/test_endings.py::test_a_small_cycle_is_not_taken_for_rest_at_a",
        "analysis/test_branches.py::test_a_branch_is_the_one_that_another_code_shoots",
        "analysis/test_branches.py::test_the_fold_is_where_another_codes_load_turns",
        "analysis/test_branches.py::test_a_cycle_loses_its_stability_at_the_fold_by",
        "analysis/test_branches.py::test_a_branch_ends_where_the_equilibrium_loses",
        "analysis/test_branches.py::test_lines_through_a_branchs_points_pass_through",
        "analysis/test_branches.py::test_a_branch_passes_the_three_folds_that_auto",
        "analysis/test_branches_of_chains.py::test_a_",
        "analysis/test_branches_of_chains.py::test_its_fold_is_where_another_codes",
        "analysis/test_branches.py::test_one_call_follows_a_branch_both_ways_through",
        "analysis/test_cycles.py::test_dry_friction_folds_the_cycle_where_it_is_known",
        "analysis/test_cycles.py::test_as_friction_vanishes_the_fold_tends_to_14",
        "analysis/test_cycles.py::test_two_multipliers_are_1_at_a_fold_and_sticking",
        "analysis/test_cycles.py::test_the_fold_moves_with_friction_as_its_derivative",
        "analysis/test_cycles.py::test_amplitude_and_period_move_as_their_derivatives",
        "analysis/test_cycles.py::test_by_taylors_steps_an_orbit_is_the_explicit_ones",
        "steady/test_certified_chains.py::test_an_orbit_of_three",
        "analysis/test_least_kicks.py::test_a_stiff_column_is_overturned_by_the_energy",
        "analysis/test_least_kicks.py::test_below_the_least_kick_it_rests_and_above_it",
        "analysis/test_least_kicks.py::test_the_least_kick_is_a_critical_kick_with_its",
        "analysis/test_least_kicks.py::test_lanes_without_a_least_kick_say_why",
        "analysis/test_least_kicks.py::test_the_energy_over_the_square_of_the_torque",
        "analysis/test_least_kicks.py::test_the_least_energy_moves_as_its_derivative",
        "analysis/test_least_kicks.py::test_scipy_agrees_on_the_least_angles",
        "analysis/test_section_planes.py",
        "analysis/test_thresholds.py::test_a_threshold_moves_as_its_derivative_says",
        "analysis/test_thresholds.py::test_by_a_cycle_that_hardly_repels_a_derivative",
        "analysis/test_thresholds.py::test_any_line_crosses_the_border_where_the_lin",
        "analysis/test_thresholds.py::test_where_a_line_begins_changes_no_derivative",
        "analysis/test_thresholds.py::test_an_interval_is_too_wide_for_a_derivative",
        "curves/test_bifurcation_curves.py::test_two_curves_of_folds_meet_in_a_cusp",
        "curves/test_changes_of_modes.py",
        "curves/test_flips_and_tori.py",
        "motion/test_every_motion_ends.py::test_a_branch_ends_within_its_budget",
        "motion/test_every_motion_ends.py::test_a_search_counts_the_steps_of_all_its",
        "motion/test_every_motion_ends.py::test_a_search_of_many_long_motions_ends",
        "motion/test_every_motion_ends.py::test_a_first_return_spends_from_the_same",
        "motion/test_every_motion_ends.py::test_results_of_searches_name_their_options",
        "sweep/test_stale_scenes.py::test_laws_that_read_an_attribute_are_traced_anew"
        "[orbit_damped",
        "test_derivatives.py::test_derivatives_of_long_motions",
        "test_refusals.py::test_traced_options_are_finite_and_positive[periodic_orbit]",
        "test_refusals.py::test_traced_options_are_finite_and_positive[its period]",
        "test_refusals.py::test_traced_options_are_finite_and_positive[bifurcation]",
        "test_refusals.py::test_traced_options_are_finite_and_positive[continue_cycle]",
        "test_refusals.py::test_traced_options_are_finite_and_positive[critical_kick]",
        "test_refusals.py::test_traced_options_that_may_be_zero_are_finite[found_orbit",
        "test_results.py::test_a_branch_is_swept",
    ],
    CERTIFIED: [
        "sweep/test_cycles_in_sweeps.py",
        "steady/test_certificates.py::test_derivatives_of_a_certified_cycle_are_those",
        "steady/test_certificates.py::test_set_valued_cycles_are_certified_where_asked",
        "steady/test_certificates.py::test_a_half_turn_and_a_whole_one_give_the_same",
        "steady/test_certificates.py::test_every_attempt_begins_with_a_shot_of_its_own",
        "steady/test_certificates.py::test_what_falls_first_and_then_grows_below_the",
        "steady/test_growth.py::test_growth_is_that_of_differences",
        "steady/test_growth.py::test_a_start_at_rest_has_no_direction_and_a_failed",
        "steady/test_rest.py::test_a_cycle_below_the_cut_is_not_rest",
        "steady/test_same_certificates.py",
        "steady/test_certificates.py::test_what_grows_from_below_the_cut_is_not_at",
        "sweep/test_tables.py::test_a_law_whose_fields_are_tables_is_swept",
        "test_main.py::test_another_map_is_refused_in_one_line_and_overwritten",
        "test_main.py::test_both_laws_have_a_store_each_and_one_picture",
        "test_main.py::test_the_cells_that_differ_are_counted_by_pairs_of_outcomes",
        "test_main.py::test_dry_friction_alone_goes_on_with_its_store_and_draws_it",
        "test_main.py::test_a_store_of_one_law_is_refused_for_another",
    ],
    LONG_RUNS: [
        "motion/test_pulsating_load.py::test_twenty_points_beside_the_first_region_grow",
        "motion/test_stick_fraction.py",
        "analysis/test_thresholds.py::test_the_ends_of_the_last_interval_stick_and",
        "motion/test_where_stiff.py::test_two_sweeps_by_the_mask_fill_each_other_up",
        "steady/test_endings.py::test_an_offset_does_not_hide_that_a_joint_rings_down",
        "steady/test_endings.py::test_a_cycle_whose_joints_turn_several_times_a_period",
        "steady/test_rest.py::test_a_cycle_below_the_noise_of_the_steps_is_not_rest",
        "analysis/test_thresholds.py::test_a_dead_load_overturns_beyond_the_energy_of",
        "motion/test_random_scenes.py::test_errors_fall_with_the_tolerance[stiff",
        "steady/test_endings.py::test_what_has_decayed_below_the_steps_error_is_at_rest[None",
        "motion/test_random_scenes.py::test_every_lane_ends_and_tells_the_truth[stiff",
        "motion/test_long_runs.py::test_the_noise_of_steps_at_rest_is_no_cycle",
        "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[dry-2",
        "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[smoothed",
        "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[dry-1",
        "analysis/test_passages.py::test_all_passages_below_the_top_of_an_angle[viscous-2",
        "analysis/test_passages.py::test_all_passages_below_the_top_of_a_rate",
        "steady/test_endings.py::test_what_grows_is_never_at_rest",
        "steady/test_endings.py::test_under_a_load_that_does_not_pay_nothing_repeats",
        "analysis/test_basins.py",
        "analysis/test_cycles.py::test_time_stepping_decays_below_the_fold_of_weak",
        "analysis/test_exponents.py::test_without_dissipation_they_sum_to_zero_in_chaos",
        "analysis/test_exponents.py::test_chaos_has_one_largest_exponent_whoever",
        "analysis/test_exponents.py::test_stick_slip_chaos",
        "analysis/test_exponents.py::test_numbers_that_break_a_rule_when_traced_end",
        "analysis/test_hysteresis.py::test_the_way_down_leaves_the_cycle_at_the_fold",
        "sweep/test_compare.py::test_smoothing_errs_in_amplitude_and_in_verdict",
        "analysis/test_thresholds.py::test_the_critical_kick_collapses_over_the_torque",
        "analysis/test_thresholds.py::test_no_kick_sets_off_flutter_below_the_fold",
        "analysis/test_thresholds.py::test_flutter_onset_and_critical_kick_are_one",
        "analysis/test_thresholds.py::test_smoothing_moves_the_critical_kick_and_less",
        "analysis/test_thresholds.py::test_a_verdict_that_changes_twice_is_noticed",
        "analysis/test_kinds.py::test_stick_slip_has_chaos_and_cycles_of_many",
        "analysis/test_kinds.py::test_a_motion_on_a_torus",
        "analysis/test_kinds.py::test_slow_motions_are_neither",
        "analysis/test_kinds.py::test_a_motion_that_lingers_by_an_unstable_cycle",
        "linear/test_critical_edges.py::test_load_frequency_and_derivatives_to_50"
        "_digits[True]",
        "linear/test_critical_edges.py::test_forward_and_reverse_agree_to_second_order",
        "linear/test_critical_loads.py::test_second_derivatives_are_those_of_the_closed",
        "maps/test_refine.py::test_the_bound_of_the_missed_area_holds_on_made_up_maps",
        "motion/test_stick_and_slip.py::test_ten_thousand_random_scenes_end_and_keep",
        "motion/test_stick_and_slip.py::test_legs_change_nothing",
        "motion/test_stick_and_slip.py::test_forward_derivatives_pass_through_events",
        "motion/test_stick_and_slip_on_reactions.py::test_the_smoothed_law_on_reactions",
        "motion/test_stick_and_slip_on_reactions.py::test_energy_and_outcomes_of_lanes",
        "motion/test_two_free_bodies.py::test_friction_on_the_joints_forces_is_followed",
        "motion/test_two_free_bodies.py::test_air_and_loads_that_follow_in_part_move",
        "solvers/test_stiff_method.py::test_stiff_motions_meet_tolerances",
        "solvers/test_stiff_method.py::test_the_cost_hardly_depends_on_the_layer",
        "solvers/test_stiff_method.py::test_creeping_joints_count_as_sticking",
        "solvers/test_stiff_method.py::test_legs_and_batches_change_nothing",
        "steady/test_rest.py::test_a_threshold_within_frictions_layer_is_that_of_long",
        "test_studies.py::test_a_small_run_of_the_distribution_ends_in_its_figures",
        "test_studies.py::test_derivatives_of_a_history_are_its_differences",
        "test_studies.py::test_coefficients_and_radius_cannot_be_told_apart",
        "test_studies.py::test_fits_spread_as_far_as_the_bound_and_have_no_bias",
    ],
    PROCESSES: [
        "sweep/test_job_arrays.py",
        "motion/test_debugging_flags.py::test_the_environments_flags_are_heeded",
        "plot/test_pages.py::test_a_store_in_si_units_makes_a_page",
        "plot/test_pictures.py::test_matplotlib_is_imported_only_when_used",
        "sweep/test_clusters.py",
        "sweep/test_progress.py::test_a_slow_compilation_is_announced_with_its_seconds",
        "sweep/test_failures_told.py::test_a_forked_process_computes_or_says_that",
        "sweep/test_store_identity.py::test_a_scenes_digest_is_the_same_in_other",
        "sweep/test_tables.py::test_a_point_that_closes_over_a_large_array_takes",
        "sweep/test_store_faults.py::test_killed_at_any_moment_it_goes_on_where_it_was",
        "sweep/test_stores_under_attack.py::test_of_two_that_begin_a_store_at_once_one",
        "test_benchmarks.py::test_a_script_runs",
        "test_benchmarks.py::test_every_script_of_these_folders",
        "test_cache.py::test_a_second_process_starts_without_compiling",
        "test_census.py::test_a_lanes_step_takes_no_more_instructions_than_it_did",
        "test_cpu.py::test_a_fresh_process_computes_on",
        "test_cpu.py::test_loops_that_are_written_out_give_the_same_bits",
        "test_interrupt.py::test_ctrl_c_ends_a_sweep_soon",
        "test_main.py::test_a_closed_stdout_is_named_and_the_map_is_written",
        "test_main.py::test_ctrl_c_gets_one_line_and_exit_code_130",
        "test_main.py::test_a_killed_map_goes_on_where_it_was_and_ends_in_the_same",
        "test_notebook.py::test_a_notebook_shows_bar_repr_and_picture",
        "test_readme.py::test_the_first_command_writes_the_map_where_it_stands",
        "test_structure.py::test_every_entry_of_the_second_tier_is_a_test_and_no_mark",
    ],
    ALL_QUESTIONS: [
        "test_options.py::test_the_tables_say_what_each_question_does_on_its_own[Windows",
        "motion/test_debugging_flags.py::test_the_package_computes_the_same_under_a",
        "motion/test_debugging_flags.py::test_set_valued_motions_and_cycles_compute",
        "test_options.py::test_a_partial_value_leaves_the_rest_to_the_question",
        "test_options.py::test_the_tables_say_what_each_question_does_on_its_own"
        "[Method]",
    ],
    OTHER_WAY: [
        "linear/test_linear_chains.py::test_its_derivatives_are_those_of_differences[all",
        "linear/test_linear_chains.py::test_the_critical_load_is_where_the_spectrum_says"
        "[all",
        "model/test_chain_of_rods.py::test_a_smoothed_motion_is_that_of_free_bodies[5",
        "model/test_own_forces.py::test_a_certificate_with_a_force_is_that_with_gravity",
        "model/test_own_forces.py::test_dashpots_written_as_a_force_are_viscous_joints",
        "model/test_own_forces.py::test_linear_questions_see_an_autonomous_force_as_they",
        "model/test_own_forces.py::test_motions_are_derived_by_a_forces_numbers_and_arr",
        "model/test_own_forces.py::test_a_sweep_maps_a_forces_numbers_and_calls_broken",
        "model/test_own_forces.py::test_rosenbrocks_order_holds_with_a_load_that_depends",
        "model/test_own_forces.py::test_what_holds_at_all_times_is_not_asked_of_a_column"
        "_in_time[b",
        "model/test_own_forces.py::test_what_holds_at_all_times_is_not_asked_of_a_column"
        "_in_time[continue",
        "steady/test_certified_chains.py::test_a_certified_cycle_is_closed_by_free_bodies"
        "[True",
        "steady/test_certified_chains.py::test_a_cycle_of_sticking_joints_is_closed_by",
        "steady/test_certified_chains.py::test_windows_see_the_period_that_is_certified",
        "steady/test_certified_chains.py::test_exponents_and_thresholds_take_three_rods",
        "maps/test_which_cycle.py::test_in_a_map_with_two_attracting_cycles_no_label",
        "sweep/test_what_is_asked.py::test_a_scene_is_the_same_beside_a_profiler",
        "steady/test_endings.py::test_a_window_of_less_than_a_return_tells_nothing",
        "sweep/test_stages.py::test_every_place_of_a_batch_rounds_alike",
        "sweep/test_sweeps.py::test_few_points_run_in_small_batches_with_the_same_bits"
        "[164-128",
        "motion/test_stick_and_slip.py::test_the_reference_motions_and_their_events"
        "[Taylor-1e-09-4e-07-6e-08-c02",
        "sweep/test_stale_scenes.py::test_laws_that_read_an_attribute_are_traced_anew"
        "[settle_observed",
        "test_refusals.py::test_a_method_may_be_an_argument_of_a_jit[method1",
        "test_si_units.py::test_each_joint_has_its_own_pin_and_its_own_transition",
        "motion/test_stick_and_slip.py::test_rates_far_too_fast_for_the_first_step_are"
        "_followed[Taylor",
        "plot/test_pages.py::test_it_says_so_of_what_was_judged_by_windows[dry",
        "sweep/test_stale_scenes.py::test_laws_that_read_an_attribute_are_traced_anew"
        "[trajectory_damped-False",
        "test_derivatives.py::test_second_derivatives_under_smoothed_friction_are_right",
        "test_results.py::test_events_are_swept_with_their_modes",
        "test_results.py::test_an_obstacle_that_there_was_not_is_none",
        "steady/test_endings.py::test_without_load_nothing_repeats[dry",
        "sweep/test_stale_scenes.py::test_laws_that_read_an_attribute_are_traced_anew"
        "[settle_rubbed",
        "test_derivatives.py::test_second_derivatives_that_would_be_wrong_are_refused[settle-",
        "test_derivatives.py::test_second_derivatives_that_would_be_wrong_are_refused[sweep",
        "test_derivatives.py::test_second_derivatives_that_would_be_wrong_are_refused[poincare",
        "test_derivatives.py::test_second_derivatives_that_would_be_wrong_are_refused[trajectory",
        "sweep/test_stale_scenes.py::test_laws_that_read_an_attribute_are_traced_anew[settle_damped-False",
        "sweep/test_sweeps.py::test_several_motions_and_what_is_not_cut_agree_with_direct_calls[two_settles-2",
        "sweep/test_sweeps.py::test_several_motions_and_what_is_not_cut_agree_with_direct_calls[under_vmap-0",
        "sweep/test_sweeps.py::test_several_motions_and_what_is_not_cut_agree_with_direct_calls[one_after_the_other-2",
        "analysis/test_kinds.py::test_each_motion_is_called_what_it_is[stuck",
        "solvers/test_stiff_method.py::test_one_step_is_that_of_the_method_with_4_by_4"
        "_systems[column1]",
        "steady/test_rest.py::test_a_rod_that_turns_back_within_a_step_has_turned_over"
        "[True]",
        "steady/test_tangents_of_the_field.py::test_a_step_in_turns_is_the_step_written"
        "_out[Dopri8]",
        "steady/test_tangents_of_the_field.py::test_a_step_in_turns_is_the_step_written"
        "_out[Vern9]",
        "steady/test_tangents_of_the_field.py::test_a_step_in_turns_is_the_step_written"
        "_out[Calvo7]",
        "sweep/test_sweeps.py::test_several_motions_and_what_is_not_cut_agree_with"
        "_direct_calls[with_jvp",
    ],
    TASKS: [
        "test_examples.py::test_a_task_runs_as_it_stands[imperfection]",
        "test_examples.py::test_a_task_runs_as_it_stands[gravity]",
        "test_examples.py::test_a_task_runs_as_it_stands[three_rods]",
        "test_examples.py::test_a_task_runs_as_it_stands[ramp]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[plot/animation",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[units/si.py 0",
        "test_studies.py::test_the_onset_load_of_the_study_can_be_traced_with_its",
        "test_examples.py::test_a_task_runs_as_it_stands[cell]",
        "test_examples.py::test_a_task_runs_as_it_stands[transforms]",
        "test_examples.py::test_a_task_runs_as_it_stands[own_map]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[plot/page.py 0]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[analysis/least",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[analysis/threshold",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[analysis/branch_off",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[maps/which_cycle",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[analysis/cont",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[analysis/hyst",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[curves/",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[motion/stiffness",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[plot/maps.py 2]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[sweep/once.py 0]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[sweep/sweep.py 0]",
        "test_docstring_examples.py::test_a_block_runs_as_it_stands[sweep/compare",
        "test_docstring_examples.py::test_an_observer_of_ones_own_finds_what_the",
        "test_docstring_examples.py::test_a_friction_law_of_ones_own_moves_the_column",
        "test_examples.py::test_a_task_runs_as_it_stands[chaos_map]",
        "test_examples.py::test_a_task_runs_as_it_stands[dask_cluster]",
        "test_examples.py::test_a_task_runs_as_it_stands[device_si]",
        "test_examples.py::test_a_task_runs_as_it_stands[hysteresis]",
        "test_examples.py::test_a_task_runs_as_it_stands[onset_over_friction]",
        "test_examples.py::test_a_task_runs_as_it_stands[own_laws]",
    ],
}


def reason_of(test):
    """Why a test is in the second tier; None where it is not."""
    name = test.removeprefix("tests/")
    for reason, entries in SLOW.items():
        if name.startswith(tuple(entries)):
            return reason
    return None


def of_the_night(test):
    """Whether a test is a large draw, which `--night` alone runs."""
    return test.removeprefix("tests/").startswith(tuple(NIGHT))


def turn_of(test):
    """The place of a test's file among those that are begun first; after them all."""
    file = test.removeprefix("tests/").split("::")[0]
    return FIRST.index(file) if file in FIRST else len(FIRST)
