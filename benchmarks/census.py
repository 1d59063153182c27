"""Instructions of a lane's step in compiled code: a measure of speed without noise.

Of the largest function in XLA's largest object file it finds the loop over steps and
the loops over lanes inside it (natural loops of the control flow, trip counts from
their compare), and counts the instructions for one vector of lanes and one step. A loop
with a table of jumps in it is that over a step's stages, and takes each arm once. Arms
that are rare (a window's end: much masking, little arithmetic) are left out; what a
loop over lanes does for a few of them counts as if for all, and in programs of
`periodic_orbit` (`tangents` in the guard) that is most. It is an estimate of work, not
of time: where measured, a program with 27 % fewer instructions took 22 % less time.

Needs `objdump`, and a jaxlib that makes one kernel of a loop. Counts of processors with
vectors of another width are not comparable.
"""

import platform
import re
import shutil
import subprocess
from collections import Counter
from pathlib import Path

ROOTS = ("vdiv", "vsqrt")
MASKS = ("k", "vcmp", "vpcmp", "vptest", "vpmovb2m", "vpmovm2", "vpsllw", "vpblendm",
         "vblend", "vfpclass")  # fmt: skip
CONSTANTS = ("movabs", "vbroadcast", "vpbroadcast", "vmovddup")
ARITHMETIC = ("vfm", "vfn", "vadd", "vsub", "vmul", "vmax", "vmin", "vrnd", "vround",
              "vand", "vor", "vxor", "vscalef")  # fmt: skip
LARGE = 2**63


def width():
    """How many float64 XLA puts into a vector here; 0 where this file knows no way."""
    if platform.machine() not in ("x86_64", "AMD64") or not Path("/proc").exists():
        return 0
    flags = re.findall(r"^flags\s*:(.*)", Path("/proc/cpuinfo").read_text(), re.M)
    known = set(flags[0].split()) if flags else set()
    return 8 if "avx512f" in known else 4 if "avx2" in known else 0


def obstacle():
    """Why there can be no census here, as a sentence; None where there can."""
    if shutil.which("objdump") is None:
        return "There is no census: objdump is not installed (binutils)."
    if not width():
        return "There is no census: the processor has neither AVX-512 nor AVX2."
    return None


def part(op, args):
    """What an instruction is for; masked moves are selects."""
    if op.startswith(ROOTS):
        return "roots"
    if op.startswith(MASKS) or (op.startswith("vmov") and "{%k" in args):
        return "masks"
    if op in ("vmovq", "vmovd"):
        return "masks" if "(" in args else "constants"
    if op.startswith(CONSTANTS):
        return "constants"
    if op.startswith("vmov"):
        return "moves"
    if op.startswith(ARITHMETIC):
        return "arithmetic"
    return "other" if op.startswith("v") else "scalar"


def objdump(path, *options):
    command = ["objdump", *options, path]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def disassembled(path):
    """The largest function: (address, operation, arguments) of each instruction."""
    text = objdump(path, "-d", "--no-show-raw-insn")
    functions = []
    for line in text.splitlines():
        if re.match(r"[0-9a-f]+ <.*>:", line):
            functions.append([])
        elif functions and (m := re.match(r"\s*([0-9a-f]+):\s+(\S+)\s*(.*)", line)):
            functions[-1].append((int(m[1], 16), m[2], m[3]))
    return max(functions, key=len)


def table(path):
    """Where jumps through a table lead: the addresses in constants' relocations."""
    text = objdump(path, "-r")
    return [int(a, 16) for a in re.findall(r"_64 +\.l?text\+0x([0-9a-f]+)", text)]


class Flow:
    """Basic blocks of a function, their dominators and natural loops."""

    def __init__(self, code, targets=()):
        """Cut `code` at its jumps; `targets`: of the one that reads a table."""
        at = {a: i for i, (a, _, _) in enumerate(code)}
        targets = [at[a] for a in targets if a in at]  # others are other functions'
        jump, heads = {}, {0, *targets}
        for i, (_, op, args) in enumerate(code):
            if op.startswith("j"):
                m = re.match(r"([0-9a-f]+)", args)
                if m and int(m[1], 16) in at:
                    jump[i] = at[int(m[1], 16)]
                    heads.add(jump[i])
            if op.startswith(("j", "ret")):
                heads.add(i + 1)
        heads = sorted(h for h in heads if h < len(code))
        bounds = list(zip(heads, [*heads[1:], len(code)], strict=True))
        index = {h: k for k, h in enumerate(heads)}
        self.blocks = [code[a:b] for a, b in bounds]
        self.next = [[] for _ in bounds]
        self.before = [[] for _ in bounds]
        self.switches = []  # blocks that end in a jump through a table
        for k, (_, end) in enumerate(bounds):
            _, op, args = code[end - 1]
            if op == "jmp" and args.startswith("*") and targets:
                self.switches.append(k)
                self.next[k] += dict.fromkeys(index[i] for i in targets)
            if end - 1 in jump:
                self.next[k].append(index[jump[end - 1]])
            falls = op != "jmp" and not op.startswith("ret") and k + 1 < len(bounds)
            if falls and k + 1 not in self.next[k]:
                self.next[k].append(k + 1)
            for n in self.next[k]:
                self.before[n].append(k)
        self.order, self.above = self._dominators()
        self.loops = self._loops()

    def _dominators(self):
        """Reverse postorder, and each block's immediate dominator (Cooper et al.)."""
        post, seen, stack = [], {0}, [(0, iter(self.next[0]))]
        while stack:
            k, rest = stack[-1]
            new = next((n for n in rest if n not in seen), None)
            if new is None:
                post.append(k)
                stack.pop()
            else:
                seen.add(new)
                stack.append((new, iter(self.next[new])))
        order = post[::-1]
        place, above, changed = {k: i for i, k in enumerate(order)}, {0: 0}, True
        while changed:
            changed = False
            for k in order[1:]:
                known = [p for p in self.before[k] if p in above]
                new = known[0]
                for other in known[1:]:
                    while other != new:
                        while place[other] > place[new]:
                            other = above[other]
                        while place[new] > place[other]:
                            new = above[new]
                if above.get(k) != new:
                    above[k], changed = new, True
        return order, above

    def dominates(self, a, b):
        """Whether every way to `b` leads through `a`."""
        while b not in (a, 0):
            b = self.above.get(b, 0)  # 0 for unreachable padding
        return a == b

    def _loops(self):
        loops = {}
        for k in self.order:
            for head in self.next[k]:
                if self.dominates(head, k):
                    body, todo = loops.setdefault(head, {head}), [k]
                    while todo:
                        if (x := todo.pop()) not in body:
                            body.add(x)
                            todo += self.before[x]
        return sorted(loops.items(), key=lambda item: -self.size(item[1]))

    def size(self, body):
        """How many instructions."""
        return sum(len(self.blocks[k]) for k in body)


def trips(tail, usual, most):
    """How often a loop inside a step runs: from its last increment and compare."""
    steps, counter, end = {}, None, None
    for _, op, args in tail:
        m = re.match(r"\$(-?0x[0-9a-f]+),(%\w+)$", args)
        if op == "inc":
            steps[args] = 1
        elif m and op in ("add", "sub"):  # 128 is added by subtracting -128
            step = int(m[1], 16) % (2 * LARGE)
            step = step - 2 * LARGE if step >= LARGE else step
            steps[m[2]] = step if op == "add" else -step
        elif m and op == "cmp":
            end, counter = int(m[1], 16), m[2]
    asked = [f"{op} {args}" for _, op, args in tail if op.startswith(("cmp", "test"))]
    if asked and re.match(r"testb? \$0x1,", asked[-1]):
        return 2  # a flag in place of a counter
    step = steps.get(counter, 0)
    if not (end and step > 0 and end >= step):
        return usual
    return min(end // step, most)  # it begins at what is left over


def loop_over_steps(flow):
    """Its head, its body, the loops inside it, and the arms of that over stages."""
    if flow.switches:
        k = flow.switches[0]
        around = [loop for loop in flow.loops if k in loop[1]]
        (head, step), stages = around[-2], around[-1][1]
        others = (n for p in flow.before[k] for n in flow.next[p] if n != k)
        heads = [*flow.next[k], *others]  # before it a compare sees to the last arm
        arms = [{x for x in stages if flow.dominates(n, x)} for n in heads]
    else:
        (head, step), stages, arms = flow.loops[0], None, []
    while True:  # down to it: the last that holds most of its parent
        inner = [(h, b) for h, b in flow.loops if b < step]
        if stages or not inner or flow.size(inner[0][1]) < 0.4 * flow.size(step):
            return head, step, [b for _, b in inner], stages, arms
        head, step = inner[0]


def census(path, lanes):
    """Instructions for a vector of lanes and a step, by what they are for."""
    flow = Flow(disassembled(path), table(path))
    head, step, inner, stages, arms = loop_over_steps(flow)
    vectors = lanes / width()
    weight = dict.fromkeys(step, 1 / vectors)
    in_loops = set()
    for body in inner:
        in_loops |= body
        tail = [x for k in sorted(body) for x in flow.blocks[k]][-10:]
        times = len(arms) if body is stages else trips(tail, vectors, lanes)
        for k in body:
            weight[k] *= times
    for k in set().union(*arms):
        weight[k] /= len(arms)

    def count(blocks):
        total = Counter()
        for k in blocks:
            for _, op, args in flow.blocks[k]:
                total[part(op, args)] += weight[k]
        return total

    everything, rare = count(step).total(), set()
    for k in step - in_loops:
        for n in flow.next[k] if len(flow.next[k]) == 2 else []:
            if flow.before[n] == [k] and n != head:
                arm = {x for x in step if flow.dominates(n, x)}
                c = count(arm)
                small = 0.01 * everything < c.total() < 0.3 * everything
                if small and c["masks"] > 0.5 * c["arithmetic"]:
                    rare |= arm
    return count(step - rare)


class Watch:
    """Counts what is compiled between two looks at the folder of `--xla_dump_to`."""

    def __init__(self, folder):
        """`folder` None: nothing is counted."""
        self.folder = None if folder is None else Path(folder)
        self.found = {}  # name: Counter, or the sentence why there is none
        self.seen = set()

    def __call__(self, name, sweep):
        """Run `sweep`, count the largest function compiled, return its dataset."""
        if self.folder is None:
            self.found[name] = obstacle()
            return sweep()
        self.seen |= set(self.folder.rglob("*.o"))
        dataset = sweep()
        new = set(self.folder.rglob("*.o")) - self.seen
        if new:
            size = {path: path.stat().st_size for path in new}
            large = [path for path in new if size[path] > 0.5 * max(size.values())]
            # of programs alike in size, that whose stages are a loop: the shots'
            chosen = max(large, key=lambda path: (len(table(path)), size[path]))
            self.found[name] = census(chosen, dataset.attrs["batch_size"])
        else:
            self.found[name] = "XLA wrote no object file of this program."
        return dataset
