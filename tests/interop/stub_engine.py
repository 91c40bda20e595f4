"""Writes an ONNX file that answers as a flow network does, at once: everything stays where it is.

    stub_engine.py FILE
"""

import sys

import onnx
from onnx import TensorProto, helper

SIZE = 64


def main():
    def tensor(name, channels):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", channels, SIZE, SIZE])

    def numbers(name, values):
        return helper.make_tensor(name, TensorProto.INT64, [len(values)], values)

    ends = [numbers("starts", [0]), numbers("ends", [2]), numbers("axes", [1])]
    nothing = helper.make_tensor("nothing", TensorProto.FLOAT, [], [0.0])
    nodes = [
        helper.make_node("Add", ["reference", "real"], ["both"]),
        helper.make_node("Slice", ["both", "starts", "ends", "axes"], ["two"]),
        helper.make_node("Mul", ["two", "nothing"], ["flow"]),
    ]
    inputs = [tensor("reference", 3), tensor("real", 3)]
    graph = helper.make_graph(nodes, "stub", inputs, [tensor("flow", 2)], [*ends, nothing])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 16)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, sys.argv[1])


main()
