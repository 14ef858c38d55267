//! Trees that LightGBM has grown, as a scan: its text form of a model, version 4.
//!
//! Features are bytes, so a threshold t is exact: the value is above t where it is above the whole number below t. Leaves
//! are log-odds and are rounded to the scan's units of 1/256.

use super::boost::TrainedForest;
use crate::trees::{MAX_DEPTH, Node};
use std::boxed::Box;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::string::{String, ToString};
use std::vec::Vec;
use std::{format, vec};

/// Units of a leaf in one of log-odds.
const SCALE: f64 = 256.0;

/// Why a model of LightGBM cannot be a scan.
#[derive(Debug, thiserror::Error)]
pub enum LightGbmError {
    /// A field that is missing or not understood.
    #[error("{}: {place}{field} is '{value}', expected {expected}", path.display())]
    Field {
        /// Path of the file.
        path: PathBuf,
        /// `tree N: `, or empty in the head.
        place: String,
        /// Name of the field.
        field: &'static str,
        /// Its value, shortened; empty where it is missing.
        value: String,
        /// The expected form, and how to get it.
        expected: String,
    },
    /// Another file.
    #[error("{}: no model of LightGBM: its first line is not 'tree'; save it with Booster.save_model", path.display())]
    Other {
        /// Path of the file.
        path: PathBuf,
    },
}

/// Fields of the head or of a tree, by name.
struct Fields<'a> {
    path: &'a Path,
    place: String,
    values: BTreeMap<&'a str, &'a str>,
}

impl Fields<'_> {
    fn wrong(&self, field: &'static str, expected: impl ToString) -> LightGbmError {
        let value = self.values.get(field).copied().unwrap_or_default();
        let mut short: String = value.chars().take(40).collect();
        if short.len() < value.len() {
            short.push_str("...");
        }
        let (path, place) = (self.path.into(), self.place.clone());
        LightGbmError::Field { path, place, field, value: short, expected: expected.to_string() }
    }

    fn get(&self, field: &'static str) -> &str {
        self.values.get(field).copied().unwrap_or_default()
    }

    /// A field that must have this value; `default` stands for a missing one.
    fn must_be(
        &self,
        field: &'static str,
        value: &str,
        default: &str,
        advice: &str,
    ) -> Result<(), LightGbmError> {
        let found = self.values.get(field).copied().unwrap_or(default);
        if found == value { Ok(()) } else { Err(self.wrong(field, format!("{value}{advice}"))) }
    }

    fn number<T: std::str::FromStr>(&self, field: &'static str) -> Result<T, LightGbmError> {
        self.get(field).parse().map_err(|_| self.wrong(field, "a whole number"))
    }

    /// A list of `length` numbers.
    fn list<T: std::str::FromStr>(
        &self,
        field: &'static str,
        length: usize,
    ) -> Result<Vec<T>, LightGbmError> {
        let numbers = self.get(field).split_whitespace().map(str::parse::<T>);
        let numbers: Option<Vec<T>> = numbers.map(Result::ok).collect();
        let fits = numbers.filter(|numbers| numbers.len() == length);
        fits.ok_or_else(|| self.wrong(field, format!("{length} numbers")))
    }
}

/// A tree with the nodes left out that a byte always passes in the same direction.
enum Branch {
    Leaf(i16),
    Split(Node, Box<Self>, Box<Self>),
}

impl Branch {
    fn depth(&self) -> u8 {
        match self {
            Self::Leaf(_) => 0,
            Self::Split(_, left, right) => 1 + left.depth().max(right.depth()),
        }
    }

    /// Puts it into a complete tree, `node` in heap order from 1; leaves behind the nodes.
    fn fill(&self, node: usize, nodes: &mut [Node], leaves: &mut [i16]) {
        let (left, right) = (2 * node, 2 * node + 1);
        match (self, node.checked_sub(1).and_then(|place| nodes.get_mut(place))) {
            (Self::Split(split, no, yes), Some(place)) => {
                *place = *split;
                no.fill(left, nodes, leaves);
                yes.fill(right, nodes, leaves);
            }
            (Self::Leaf(_), Some(place)) => {
                *place = Node::LEFT;
                self.fill(left, nodes, leaves);
                self.fill(right, nodes, leaves);
            }
            (Self::Leaf(value), None) => {
                let place = node - 1 - nodes.len();
                if let Some(leaf) = leaves.get_mut(place) {
                    *leaf = *value;
                }
            }
            // Trees are as deep as the deepest branch.
            (Self::Split(..), None) => {}
        }
    }
}

/// One tree as its lists have it.
struct ListedTree<'a> {
    fields: Fields<'a>,
    features: Vec<usize>,
    thresholds: Vec<f64>,
    children: [Vec<i64>; 2],
    leaves: Vec<f64>,
}

impl ListedTree<'_> {
    /// The branch at `child`: a node from 0, or a leaf counted from -1 down. `left` bounds the nodes that may still be seen.
    fn branch(&self, child: i64, left: &mut usize) -> Result<Branch, LightGbmError> {
        let fields = &self.fields;
        let Ok(node) = usize::try_from(child) else {
            let leaf = usize::try_from(-(child + 1)).ok().and_then(|leaf| self.leaves.get(leaf));
            let Some(leaf) = leaf else {
                return Err(fields.wrong("left_child", "numbers of nodes and leaves that exist"));
            };
            let units = (leaf * SCALE).round();
            if !(f64::from(i16::MIN)..=f64::from(i16::MAX)).contains(&units) {
                return Err(fields.wrong("leaf_value", "log-odds from -128 to 127"));
            }
            return Ok(Branch::Leaf(units as i16));
        };
        let parts = (
            self.features.get(node),
            self.thresholds.get(node),
            self.children[0].get(node),
            self.children[1].get(node),
        );
        let (Some(&feature), Some(&threshold), Some(&no), Some(&yes)) = parts else {
            return Err(fields.wrong("left_child", "numbers of nodes and leaves that exist"));
        };
        *left = left
            .checked_sub(1)
            .ok_or_else(|| fields.wrong("left_child", "a tree: no node is the child of two"))?;
        if threshold < 0.0 {
            return self.branch(yes, left);
        }
        if threshold >= 255.0 {
            return self.branch(no, left);
        }
        let feature =
            u16::try_from(feature).map_err(|_| fields.wrong("split_feature", "features"))?;
        let node = Node { feature, threshold: threshold.floor() as u16 };
        let (no, yes) = (self.branch(no, left)?, self.branch(yes, left)?);
        Ok(Branch::Split(node, Box::new(no), Box::new(yes)))
    }
}

/// The forest in the text of a file; of `features` features those that `seen` allows may be asked for.
///
/// # Errors
/// [`LightGbmError`] naming the file, the tree and the field.
pub fn forest(
    path: &Path,
    text: &str,
    features: u16,
    seen: impl Fn(usize) -> bool,
) -> Result<TrainedForest, LightGbmError> {
    let mut blocks = text.split("\nTree=");
    let head = fields(path, String::new(), blocks.next().unwrap_or_default());
    if text.lines().next().map(str::trim) != Some("tree") {
        return Err(LightGbmError::Other { path: path.into() });
    }
    if !["v3", "v4"].contains(&head.get("version")) {
        return Err(head.wrong("version", "v3 or v4"));
    }
    head.must_be("num_class", "1", "1", ": a model of two classes")?;
    head.must_be("num_tree_per_iteration", "1", "1", ": a model of two classes")?;
    if head.get("objective") != "binary sigmoid:1" {
        return Err(head.wrong("objective", "binary sigmoid:1: train with objective=binary"));
    }
    if text.lines().any(|line| line.trim() == "average_output") {
        return Err(head.wrong("average_output", "no such line: train with boosting=gbdt"));
    }
    let last: usize = head.number("max_feature_idx")?;
    if last >= usize::from(features) {
        let expected = format!("at most {}: the columns of `lookout mine --csv`", features - 1);
        return Err(head.wrong("max_feature_idx", expected));
    }
    let mut branches = Vec::new();
    for block in blocks {
        branches.push(tree(path, block, last, &seen)?);
    }
    if branches.is_empty() {
        return Err(head.wrong("tree_sizes", "one tree at least"));
    }
    let whole = text.lines().any(|line| line.trim() == "end of trees");
    let sizes = head.get("tree_sizes").split_whitespace().count();
    if !whole || sizes != branches.len() {
        let expected = format!("a size for each of {} trees and 'end of trees'", branches.len());
        return Err(head.wrong("tree_sizes", expected));
    }
    let depth = branches.iter().map(Branch::depth).max().unwrap_or(0).max(1);
    let trees = branches.iter().map(|branch| {
        let mut nodes = vec![Node::LEFT; (1 << depth) - 1];
        let mut leaves = vec![0; 1 << depth];
        branch.fill(1, &mut nodes, &mut leaves);
        (nodes, leaves)
    });
    let trees: Vec<_> = trees.collect();
    TrainedForest::of_trees(depth, features, trees)
        .ok_or_else(|| head.wrong("tree_sizes", "at most 32767 trees"))
}

/// The fields of a block: lines `NAME=VALUE` up to the first empty one.
fn fields<'a>(path: &'a Path, place: String, block: &'a str) -> Fields<'a> {
    let lines = block.lines().take_while(|line| !line.trim().is_empty());
    let values = lines.filter_map(|line| line.trim().split_once('=')).collect();
    Fields { path, place, values }
}

fn tree(
    path: &Path,
    block: &str,
    last: usize,
    seen: &impl Fn(usize) -> bool,
) -> Result<Branch, LightGbmError> {
    let number = block.lines().next().unwrap_or_default().trim();
    let fields = fields(path, format!("tree {number}: "), block);
    fields.must_be("num_cat", "0", "0", ": no categories")?;
    fields.must_be("is_linear", "0", "0", ": train with linear_tree=false")?;
    let leaves: usize = fields.number("num_leaves")?;
    if leaves == 0 || leaves > 1 << MAX_DEPTH {
        let most = 1 << MAX_DEPTH;
        return Err(fields.wrong("num_leaves", format!("1 to {most}: train with max_depth=8")));
    }
    let nodes = leaves - 1;
    let listed = ListedTree {
        features: fields.list("split_feature", nodes)?,
        thresholds: fields.list("threshold", nodes)?,
        children: [fields.list("left_child", nodes)?, fields.list("right_child", nodes)?],
        leaves: fields.list("leaf_value", leaves)?,
        fields,
    };
    let fields = &listed.fields;
    let decisions: Vec<u8> = fields.list("decision_type", nodes)?;
    if decisions.iter().any(|kind| kind & 1 == 1) {
        return Err(fields.wrong("decision_type", "no categories"));
    }
    if decisions.iter().any(|kind| (kind >> 2) & 3 == 1) {
        return Err(fields.wrong(
            "decision_type",
            "no zeros for missing values: train with zero_as_missing=false",
        ));
    }
    if listed.features.iter().any(|&feature| feature > last || !seen(feature)) {
        return Err(
            fields.wrong("split_feature", format!("features from 0 to {last} that the method has"))
        );
    }
    if listed.thresholds.iter().any(|threshold| threshold.is_nan()) {
        return Err(fields.wrong("threshold", "numbers"));
    }
    let root = if nodes == 0 { -1 } else { 0 };
    let branch = listed.branch(root, &mut nodes.clone())?;
    if branch.depth() > MAX_DEPTH {
        let expected = format!("a tree of depth {MAX_DEPTH} at most: train with max_depth=8");
        return Err(fields.wrong("left_child", expected));
    }
    Ok(branch)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trees::Forest;

    const MODEL: &str = "tree\nversion=v4\nnum_class=1\nnum_tree_per_iteration=1\nmax_feature_idx=9\nobjective=binary sigmoid:1\ntree_sizes=1 1\n\n\
        Tree=0\nnum_leaves=4\nnum_cat=0\nsplit_feature=3 1 7\nthreshold=10.5 -1.5 254.5\ndecision_type=2 2 2\nleft_child=1 -1 -2\nright_child=2 -3 -4\n\
        leaf_value=0.5 -0.25 1.5 2.001\nis_linear=0\n\n\nTree=1\nnum_leaves=1\nnum_cat=0\nleaf_value=0.125\n\n\nend of trees\n";

    fn read(text: &str) -> Result<TrainedForest, String> {
        forest(Path::new("m.txt"), text, 10, |feature| feature != 5).map_err(|e| e.to_string())
    }

    #[test]
    fn scores_are_sums_of_rounded_leaves() {
        let forest = read(MODEL).unwrap();
        let bytes = forest.encode();
        let (view, _) = Forest::parse(&bytes).unwrap();
        let score = |values: [u8; 10]| {
            view.score(|feature, threshold| u16::from(values[usize::from(feature)]) > threshold)
        };
        let mut values = [0; 10];
        // Below -1.5 is no byte: the second node always answers yes.
        assert_eq!(score(values), 384 + 32);
        values[3] = 10;
        assert_eq!(score(values), 384 + 32);
        values[3] = 11;
        assert_eq!(score(values), -64 + 32);
        values[7] = 254;
        assert_eq!(score(values), -64 + 32);
        values[7] = 255;
        assert_eq!(score(values), 512 + 32);
    }

    #[test]
    fn faults_are_named_with_file_tree_and_field() {
        for (from, to, words) in [
            ("tree\nversion", "forest\nversion", "m.txt: no model of LightGBM"),
            ("version=v4", "version=v9", "m.txt: version is 'v9', expected v3 or v4"),
            ("num_class=1", "num_class=3", "num_class is '3'"),
            ("binary sigmoid:1", "regression", "objective is 'regression'"),
            (
                "max_feature_idx=9",
                "max_feature_idx=10",
                "max_feature_idx is '10', expected at most 9",
            ),
            ("max_feature_idx=9", "max_feature_idx=x", "expected a whole number"),
            ("tree_sizes=1 1", "tree_sizes=1", "a size for each of 2 trees"),
            ("end of trees", "", "'end of trees'"),
            (
                "split_feature=3 1 7",
                "split_feature=3 1",
                "tree 0: split_feature is '3 1', expected 3 numbers",
            ),
            ("split_feature=3 1 7", "split_feature=3 1 5", "tree 0: split_feature"),
            ("split_feature=3 1 7", "split_feature=3 1 11", "tree 0: split_feature"),
            ("threshold=10.5", "threshold=nan", "tree 0: threshold"),
            ("threshold=10.5", "threshold=ten", "tree 0: threshold"),
            ("decision_type=2 2 2", "decision_type=1 2 2", "no categories"),
            ("decision_type=2 2 2", "decision_type=6 2 2", "zero_as_missing=false"),
            ("left_child=1 -1 -2", "left_child=0 -1 -2", "tree 0: left_child"),
            ("left_child=1 -1 -2", "left_child=1 -1 -9", "tree 0: left_child"),
            ("left_child=1 -1 -2", "left_child=7 -1 -2", "tree 0: left_child"),
            ("2.001", "500.5", "tree 0: leaf_value"),
            ("num_leaves=4", "num_leaves=0", "tree 0: num_leaves"),
            ("num_leaves=4", "num_leaves=999", "max_depth=8"),
            ("is_linear=0", "is_linear=1", "linear_tree=false"),
            ("num_cat=0", "num_cat=2", "tree 0: num_cat"),
            ("version=v4", "version=v4\naverage_output", "boosting=gbdt"),
        ] {
            assert!(MODEL.contains(from), "{from}");
            let error = read(&MODEL.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(words), "{to}: {error}");
        }
    }

    #[test]
    fn trees_that_are_too_deep_are_refused() {
        let depth = 9;
        let list = |of: &dyn Fn(usize) -> String| (0..depth).map(of).collect::<Vec<_>>().join(" ");
        let left = list(&|i| if i + 1 < depth { (i + 1).to_string() } else { "-1".into() });
        let right = list(&|i| format!("-{}", i + 2));
        let leaves = (0..=depth).map(|_| "1").collect::<Vec<_>>().join(" ");
        let head = MODEL.split("\n\n").next().unwrap().replace("tree_sizes=1 1", "tree_sizes=1");
        let text = format!(
            "{head}\n\nTree=0\nnum_leaves={}\nnum_cat=0\nsplit_feature={}\nthreshold={}\ndecision_type={}\nleft_child={left}\n\
             right_child={right}\nleaf_value={leaves}\n\n\nend of trees\n",
            depth + 1,
            list(&|_| "1".into()),
            list(&|i| (20 - i).to_string()),
            list(&|_| "2".into()),
        );
        let error = read(&text).unwrap_err();
        assert!(error.contains("tree 0: left_child") && error.contains("max_depth=8"), "{error}");
    }
}
