"""Run a sweep in memory or into a store, alone or shared."""

import os
import time
import warnings
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from slippulse_jax.block import Control
from slippulse_jax.interface import Interface
from slippulse_jax.lattice.front import DEFAULT_MAX_CONTACTS
from slippulse_jax.lattice.modes import RightEnd
from slippulse_jax.sweeps import dataset
from slippulse_jax.sweeps import store as stores
from slippulse_jax.sweeps.outputs import OUTPUTS, choose, evaluate
from slippulse_jax.sweeps.request import Columns, Request, make_request, with_interface
from slippulse_jax.sweeps.store import Store, StoreError

LARGE, SMALL, COSTLY = 1 << 20, 1 << 14, 1 << 7
"""Points per chunk by default: of lengths by the recursion, of anything that costs more, and of blocks."""

_PROBE, _PAUSE = 1024, 0.2  # points computed again on resuming; seconds between two looks at the store


def sweep(
    *,
    height: ArrayLike,
    stiffness: ArrayLike,
    poisson: ArrayLike,
    prestress: ArrayLike | None = None,
    threshold_slope: ArrayLike | None = None,
    repin_delay: ArrayLike | None = None,
    width: ArrayLike | None = None,
    push_height: ArrayLike | None = None,
    push_width: ArrayLike | None = None,
    push_control: Control = "displacement",
    interface: Interface | None = None,
    points: bool = False,
    outputs: str | tuple[str, ...] | list[str] = ("length", "status"),
    right: RightEnd = "semi-infinite",
    sites: int | None = None,
    max_contacts: int = DEFAULT_MAX_CONTACTS,
    store: str | os.PathLike[str] | None = None,
    resume: bool = True,
    chunk: int | None = None,
    share: tuple[int, int] | None = None,
    progress: bool | None = None,
) -> xr.Dataset:
    """Compute first precursors over ranges of parameters, as a labelled dataset.

    Parameters
    ----------
    height, stiffness, poisson : array_like
        H/λc, k/K and ν: each a number, or a one-dimensional array, which becomes an axis.
    prestress, threshold_slope, repin_delay : array_like, optional
        Parameters of the interface to sweep, likewise; as for `Interface`.
    width : array_like, optional
        Width of the smooth break rule, in σ_s, for the output ``smooth_length``.
    push_height, push_width : array_like, optional
        Height of the push on a block and of the pusher itself, over H, for the output ``block_precursor_length``: as for
        `Push`.
    push_control : {"displacement", "force"}
        What is held while an event of a block runs.
    interface : Interface, optional
        Of numbers, for the parameters of the interface that are fixed.
    points : bool
        Take the arrays together, as points, instead of every combination.
    outputs : str or sequence of str
        Names of `slippulse_jax.sweeps.outputs.OUTPUTS`, or "gradients", "theory", "validity".
    right, sites, max_contacts
        As for `precursor_length`.
    store : path, optional
        Folder to write the result to as it is computed, in constant memory; a sweep found there is resumed.
    resume : bool
        Whether a sweep found in `store` may be resumed.
    chunk : int, optional
        Points per file of the store.
    share : (int, int), optional
        Index and number of the processes that share the sweep; by default those of ``jax.distributed``. Chunk i belongs to
        process i mod number.
    progress : bool, optional
        Show a progress bar, on stderr or in the notebook; by default only on a terminal.

    Returns
    -------
    xarray.Dataset
        One variable per output, one dimension per axis, in float64, with units, versions and request as attributes. A
        stored sweep is read on demand. Attribute ``complete`` is 0 while shares of other processes are missing.

    Raises
    ------
    ValueError
        If a parameter or an output is not valid, before anything is computed.
    StoreError
        A `ValueError`: if the store belongs to another request, version or processor.

    Notes
    -----
    The bits of a point depend on its own parameters alone: not on chunks, resuming, processes or number of devices.
    """
    given: dict[str, Any] = {
        "height": height, "stiffness": stiffness, "poisson": poisson, "prestress": prestress,
        "threshold_slope": threshold_slope, "repin_delay": repin_delay, "width": width,
        "push_height": push_height, "push_width": push_width,
    }  # fmt: skip
    given = with_interface(given, interface)
    chosen = choose(outputs, {name for name, values in given.items() if values is not None})
    request = make_request(
        given, points=points, outputs=chosen, right=right, sites=sites, max_contacts=max_contacts, push_control=push_control
    )
    _check_right_end(request)
    index, count = _check_share(share)
    if chunk is not None and chunk < 1:
        raise ValueError(f"chunk = {chunk}: must be at least one point")
    if store is None:
        if count > 1:
            raise ValueError(f"{count} processes share this sweep: give it a store they can all write to")
        return dataset.in_memory(request, _compute_all(request, chunk or default_chunk(request), progress))
    folder = _open_or_create(Path(store), request, chunk, resume)
    _compute_missing(folder, index, count, progress)
    if share is None and count > 1:
        _wait_for_other_processes(folder)
    return dataset.stored(folder)


def open_sweep(store: str | os.PathLike[str]) -> xr.Dataset:
    """Open a stored sweep, finished or not, as a labelled dataset.

    Its values are read on demand.

    Points not yet computed are NaN (−1 in whole numbers), and the attribute ``complete`` is 0 then.

    Raises
    ------
    StoreError
        If the folder holds no sweep, or a damaged one; of a damaged chunk, when it is read.
    """
    return dataset.stored(stores.open_store(Path(store)))


def default_chunk(request: Request) -> int:
    """Points per chunk: enough that files are few, few enough that little is lost by a kill."""
    groups = {OUTPUTS[name].group for name in request.outputs}
    return COSTLY if "block" in groups else LARGE if groups <= {"length", "load"} else SMALL


def _check_right_end(request: Request) -> None:
    if request.right == "semi-infinite":
        return
    for name in request.outputs:
        if OUTPUTS[name].group not in ("length", "front", "load", "gradient"):
            raise ValueError(f"output {name!r} is for a semi-infinite chain, not right = {request.right!r}")


def _check_share(share: tuple[int, int] | None) -> tuple[int, int]:
    if share is None:
        return jax.process_index(), jax.process_count()
    index, count = share
    if not 0 <= index < count:
        raise ValueError(f"share = {share}: must be (index, number of processes) with 0 <= index < number")
    return index, count


def _open_or_create(path: Path, request: Request, chunk: int | None, resume: bool) -> Store:
    if not stores.exists(path):
        stores.create(path, request, chunk or default_chunk(request))
    elif not resume:
        raise StoreError(f"{path}: holds a sweep already; resume it, or give another folder")
    store = stores.open_store(path)
    stores.check_same(store, request, chunk)
    return store


def _compute_missing(store: Store, index: int, count: int, progress: bool | None) -> None:
    """Compute the chunks of this process that are missing or damaged; one is written while the next is computed."""
    mine = range(index, store.chunks, count)
    _check_digits(store)
    with _bar(sum(b - a for a, b in map(store.span, mine)), progress) as bar, ThreadPoolExecutor(1) as writer:
        writing: Future[None] | None = None
        for one in mine:
            start, stop = store.span(one)
            columns = None if _is_whole(store, one) else evaluate(store.request, start, stop)
            if writing is not None:
                writing.result()
            writing = None if columns is None else writer.submit(_write, store, one, columns)
            bar.update(stop - start)
        if writing is not None:
            writing.result()


def _write(store: Store, index: int, columns: Columns) -> None:
    store.clear_leftovers(index)
    store.write(index, columns)


def _is_whole(store: Store, index: int) -> bool:
    try:
        store.read(index)
    except FileNotFoundError:
        return False
    except StoreError as error:
        warnings.warn(f"{error}: computing it again", RuntimeWarning, stacklevel=4)
        return False
    return True


def _check_digits(store: Store) -> None:
    """Compute the first stored points again: another processor or build may round differently."""
    for one in store.present():
        try:
            there = store.read(one)
        except StoreError:
            continue
        start, stop = store.span(one)
        again = evaluate(store.request, start, min(stop, start + _PROBE))
        for name, values in again.items():
            if values.tobytes() != there[name][: len(values)].tobytes():
                raise StoreError(f"{store.path}: computed here, the first points of {name} have other digits than stored")
        return


def _wait_for_other_processes(store: Store) -> None:
    """Wait until every chunk is there; if a process dies, jax.distributed ends the others."""
    while len(store.present()) < store.chunks:
        time.sleep(_PAUSE)


def _compute_all(request: Request, chunk: int, progress: bool | None) -> Columns:
    """Compute all points in memory."""
    columns = {name: np.empty(request.size, OUTPUTS[name].dtype) for name in request.outputs}
    with _bar(request.size, progress) as bar:
        for start in range(0, request.size, chunk):
            stop = min(start + chunk, request.size)
            for name, values in evaluate(request, start, stop).items():
                columns[name][start:stop] = values
            bar.update(stop - start)
    return columns


def _bar(size: int, progress: bool | None) -> Any:
    """Progress bar with the time left; by default only on a terminal."""
    from tqdm.auto import tqdm

    disable = None if progress is None else not progress
    return tqdm(total=size, unit=" points", unit_scale=True, disable=disable, desc="sweep")
